"""The scenes of a batch, listed from its sources before any work. Each has a unique id and folder name."""

import os
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ...data.nuscenes_submission import check_sample_tokens
from ...data.one_scene import OneScene, ScenePiece, find_pieces
from ...data.scene_folder import NotASceneFolderError
from ...data.scene_schema import SCENE_NAME
from ...data.source import Source
from ...runtime.errors import InputError, UsageError
from ...runtime.printable import printable
from ...runtime.progress import Progress
from ..notify import Notify
from ..sources import NUSCENES, SYNTHETIC, TRUSTED, SourceName, open_source, source_path
from .folder_names import folder_names

MANY_SOURCES = 20  # opening fewer takes about a second
_FILE = f"/{SCENE_NAME}"


@dataclass(frozen=True)
class Scene:
    """One job of a batch.

    scene_id: different for all scenes of the batch.
    folder: name of its folder, see `folder_names`.
    source: name of its source; relative paths are made absolute, for processes in other folders.
    piece: its frames in the source.
    identity: of the source `OneScene`.
    error: why the source cannot be read. Such a scene fails.
    """

    scene_id: str
    folder: str
    source: str
    piece: ScenePiece
    identity: str
    error: str | None = None

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return asdict(self) | {"piece": list(self.piece)}

    @classmethod
    def from_dict(cls, fields: dict[str, Any]) -> "Scene":
        """The opposite of `to_dict`."""
        return cls(**fields | {"piece": ScenePiece(*fields["piece"])})


def find_scenes(
    sources: Sequence[SourceName], *, check_tokens: bool, progress: Progress, notify: Notify
) -> list[Scene]:
    """Open all sources and list their scenes in order.

    Scenes of different sources are kept apart, also if they have the same name, and so are the pieces of a scene whose
    frames are not consecutive: the history is reset at the beginning of each piece anyway.
    check_tokens: check that every frame has a unique token, for a nuScenes submission.

    Raises InputError for a source that does not exist, and UsageError for a source that is given twice. A scene folder
    whose `scene.json` is not valid becomes a scene with an error.
    """
    _check_different(sources)
    scenes: list[Scene] = []
    used: set[str] = set()
    tokens: list[str] = []
    shown = progress(sources, "open sources") if len(sources) > MANY_SOURCES else sources
    for number, name in enumerate(shown, start=1):
        try:
            source = open_source(name, checked=False, progress=progress)
        except NotASceneFolderError:
            raise
        except InputError as error:
            if str(name).startswith((NUSCENES, SYNTHETIC)):
                raise
            scenes.append(_broken_scene(name, number, used, str(error)))
            continue
        scenes += _scenes_of(source, name, number, used, notify)
        tokens += source.tokens if check_tokens else ()
    if check_tokens:
        check_sample_tokens(tokens)
    folders = folder_names([scene.scene_id for scene in scenes])
    return [replace(scene, folder=folder) for scene, folder in zip(scenes, folders, strict=True)]


def _check_different(sources: Sequence[SourceName]) -> None:
    seen: dict[str, SourceName] = {}
    for name in sources:
        text = str(name)
        is_folder = not text.startswith((NUSCENES, SYNTHETIC))
        key = os.path.realpath(source_path(name)).removesuffix(_FILE) if is_folder else text
        if key in seen:
            raise UsageError(
                f"sources: expected each source once; got {str(seen[key])!r} and {text!r}. Leave one of them out."
            )
        seen[key] = name


def _absolute_name(name: SourceName) -> str:
    """The name with an absolute path, which processes in other folders can open too."""
    text = str(name)
    if text.startswith(SYNTHETIC):
        return text
    prefix = next((prefix for prefix in (NUSCENES, TRUSTED) if text.startswith(prefix)), "")
    return f"{prefix}{Path.cwd() / text.removeprefix(prefix)}"


def _scenes_of(source: Source, name: SourceName, number: int, used: set[str], notify: Notify) -> Iterator[Scene]:
    """The scenes of a source. used: ids so far; the new ones are added."""
    pieces = find_pieces(source)
    num_pieces = Counter(piece.name for piece in pieces)
    for scene_name, count in num_pieces.items():
        if count > 1:
            notify(
                f"warning: {name}: the frames of scene {scene_name!r} are in {count} separate pieces. Each piece is a "
                "scene of its own."
            )
    passed: Counter[str] = Counter()
    for piece in pieces:
        passed[piece.name] += 1
        scene_id = piece.name if passed[piece.name] == 1 else f"{piece.name} (piece {passed[piece.name]})"
        scene_id = _unused(scene_id, number, used)
        yield Scene(scene_id, "", _absolute_name(name), piece, OneScene(source, piece).identity)


def _broken_scene(name: SourceName, number: int, used: set[str], error: str) -> Scene:
    """A scene with an error, in place of a source that cannot be read. It has the name of the source's folder."""
    path = Path(_absolute_name(name).removeprefix(TRUSTED))
    folder = path.parent if path.suffix == ".json" else path
    scene_id = _unused(printable(folder.name) or "scene", number, used)
    return Scene(scene_id, "", _absolute_name(name), ScenePiece("", 0, 0), "", error)


def _unused(scene_id: str, number: int, used: set[str]) -> str:
    """Add an id to the used ones. If it is used, it gets the number of its source, as in `data.joined_source`."""
    while scene_id in used:
        scene_id += f" (source {number})"
    used.add(scene_id)
    return scene_id
