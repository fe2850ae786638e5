"""The name of a nuScenes source, `ROOT[@VERSION][/SPLIT]`: which folders and which scenes it means."""

import difflib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from ...runtime.errors import InputError
from ...runtime.printable import printable

FORM = "nuscenes:ROOT[@VERSION][/SPLIT]"
VERSION_PATTERN = "v1.0-*"
TABLE = "sample.json"  # a folder with this file holds the tables of a version


class RootName(NamedTuple):
    """The parts of a name.

    root: the folder that file names of images are relative to.
    version: name of the folder in it that holds the tables.
    split: a split or scene names; None for all scenes.
    """

    root: Path
    version: str
    split: str | None

    @property
    def folder(self) -> Path:
        """The version folder."""
        return self.root / self.version


def parse_root_name(text: str) -> RootName:
    """Split `ROOT[@VERSION][/SPLIT]` into its parts. ROOT may hold `@` and `/`, so the folders that exist decide.

    Without a version, the only folder `v1.0-*` of the root is taken.
    Raises InputError if there is no such root or version, or if the root has several versions and none is named.
    """
    if not text:
        raise InputError(f"expected a nuScenes root as {FORM}, for example nuscenes:/data/nuscenes; got no folder.")
    readings = list(_readings(text.rstrip("/") or text))
    if _is_version_folder(Path(text)):  # the next reading would take its name for a split
        raise InputError(_message(text, readings))
    for root, version, split in readings:
        if _is_folder(root) and (version is None or _has_tables(root / version)):
            versions = [version] if version is not None else _find_versions(root)
            if versions:
                return RootName(root, _only_version(root, versions), split)
    raise InputError(_message(text, readings))


def _readings(text: str) -> Iterator[tuple[Path, str | None, str | None]]:
    """Yield each way to read a name as root, version and split, the longest root first."""
    yield Path(text), None, None
    parent, _, split = text.rpartition("/")
    before, at, after = text.rpartition("@")
    if at and "/" not in after:
        yield Path(before), after, None
    elif parent:
        yield Path(parent), None, split
    if at and after.count("/") == 1:
        version, _, split = after.partition("/")
        yield Path(before), version, split


def _only_version(root: Path, versions: list[str]) -> str:
    if len(versions) > 1:
        raise InputError(
            f"{root}: expected a version, because this nuScenes root has several ({printable(', '.join(versions))}); "
            f"got none. Name one: nuscenes:{root}@{printable(versions[0])}."
        )
    return versions[0]


def _find_versions(root: Path) -> list[str]:
    return sorted(folder.name for folder in root.glob(VERSION_PATTERN) if folder.is_dir())


def _has_tables(folder: Path) -> bool:
    return _is_folder(folder) and (folder.match(VERSION_PATTERN) or (folder / TABLE).exists())


def _is_version_folder(path: Path) -> bool:
    return _is_folder(path) and (path / TABLE).exists() and not _find_versions(path)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # such as a name of more than 255 bytes
        return False


def _message(text: str, readings: list[tuple[Path, str | None, str | None]]) -> str:
    """Return the message for a name whose folders do not exist, about its most likely reading."""
    existing = [reading for reading in readings if _is_folder(reading[0])]
    if not existing:
        return f"{text}: expected a nuScenes root as {FORM}, for example nuscenes:/data/nuscenes; got no such folder."
    # A version, if one is given; otherwise the longest folder that exists.
    root, version, split = existing[-1] if existing[-1][1] is not None else existing[0]
    if version is None and _is_version_folder(root):
        name = f"nuscenes:{root.parent}@{root.name}" + ("" if split is None else f"/{printable(split)}")
        return f"{root}: expected a nuScenes root; got a version folder. Write {name}."
    versions = _find_versions(root)
    if version is None and split is None:
        return f"{root}: expected a nuScenes root with a folder {VERSION_PATTERN} of tables; got a folder without one."
    if version is None:
        return (
            f"{text}: expected a nuScenes root as {FORM}; got no such folder, and {root} has no folder "
            f"{VERSION_PATTERN} of tables."
        )
    similar = difflib.get_close_matches(version, versions, n=1)
    hint = f" Similar: {printable(similar[0])}." if similar else ""
    return (
        f"{root}: expected a version of this nuScenes root ({printable(', '.join(versions)) or 'it has none'}); got "
        f"{printable(version) + ', which is not a folder with tables' if version else 'no name after @'}.{hint}"
    )
