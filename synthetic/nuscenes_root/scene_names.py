"""The version of a root and the names of its scenes, taken from the published splits of nuScenes.

Tools choose the scenes of a split by name: `val` is a list of 150 names. So the scenes of a root have names of these
lists, and splits work as on the dataset itself.
"""

from collections.abc import Mapping
from typing import NamedTuple

from ...data.nuscenes.splits import published_split
from ...runtime.errors import UsageError
from ...runtime.printable import shortened

SPLITS: Mapping[str, tuple[str, ...]] = {  # by version
    "v1.0-mini": ("mini_train", "mini_val"),
    "v1.0-trainval": ("train", "val"),
    "v1.0-test": ("test",),
}


class RootVersion(NamedTuple):
    """A version of nuScenes.

    name: such as v1.0-mini; the folder of the tables.
    scenes: the names of the scenes.
    has_annotations: false for the test split.
    """

    name: str
    scenes: tuple[str, ...]
    has_annotations: bool


def choose_version(num_scenes: int, split: str | None = None) -> RootVersion:
    """The version and the scene names of a root.

    split: take the first names of this split. If None, take those of v1.0-mini for up to 10 scenes, and those of
        v1.0-trainval for more, in the order of their numbers, which mixes train and val.
    Raises UsageError for an unknown split, and for more scenes than there are names.
    """
    version = _version_of(split, num_scenes)
    splits = SPLITS[version] if split is None else (split,)
    names = sorted(name for each in splits for name in published_split(each))
    if num_scenes > len(names):
        raise UsageError(
            f"--scenes: expected at most {len(names)}, the scenes of {' and '.join(splits)}; got {num_scenes}."
        )
    return RootVersion(version, tuple(names[:num_scenes]), version != "v1.0-test")


def _version_of(split: str | None, num_scenes: int) -> str:
    if split is None:
        num_mini = sum(len(published_split(each)) for each in SPLITS["v1.0-mini"])
        return "v1.0-mini" if num_scenes <= num_mini else "v1.0-trainval"
    for version, splits in SPLITS.items():
        if split in splits:
            return version
    known = ", ".join(name for splits in SPLITS.values() for name in splits)
    raise UsageError(f"--split: expected one of {known}; got {shortened(split)}.")
