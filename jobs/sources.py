"""Opening a source by its name: a scene folder, `nuscenes:ROOT[@VERSION][/SPLIT]` or `synthetic:SEED[:FRAMES]`.

`trusted:FOLDER` is a scene folder whose `scene.json` may name files outside the folder.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..data.joined_source import join_sources
from ..data.mask_grid import MaskGrid
from ..data.scene_folder import SceneFolder
from ..data.source import ImageFiles, Source
from ..runtime.bundle.manifest import PerceptionRange
from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.errors import UsageError
from ..runtime.progress import Progress, no_progress

if TYPE_CHECKING:
    from ..data.nuscenes.nuscenes_source import NuscenesSource
    from ..model.config import VoxelGrid
    from ..rig.recording import Recording
    from ..synthetic.drive import SyntheticDrive

NUSCENES = "nuscenes:"
TRUSTED = "trusted:"
SYNTHETIC = "synthetic:"

SourceName = str | Path
SourceNames = SourceName | Sequence[SourceName]  # one source, or several that follow one another


def open_source(
    name: str | Path, grid: MaskGrid | None = None, progress: Progress = no_progress, checked: bool = True
) -> Source:
    """Open a scene folder, `trusted:FOLDER`, `nuscenes:ROOT[@VERSION][/SPLIT]` or `synthetic:SEED[:FRAMES]`.

    grid: of the map masks of nuScenes and of synthetic scenes, see `map_grid`. A scene folder has its own. If None,
        frames of nuScenes have no maps, and synthetic scenes have 200 x 200 cells.
    progress: of the index of a nuScenes root, which is built when the root is opened for the first time.
    checked: False leaves the check of calibrations, poses and times to the caller.
    Raises InputError if there is no such source, and OutputError if the index cannot be written.
    """
    if str(name).startswith(NUSCENES):
        return _open_nuscenes(name, checked, progress, grid)
    if str(name).startswith(SYNTHETIC):
        return _open_drive(name, grid)
    return _open_folder(name, checked)


def map_grid(perception: "PerceptionRange | VoxelGrid", map_classes: Sequence[str]) -> MaskGrid | None:
    """The grid of a model's map masks; None for a model without map classes."""
    if not map_classes:
        return None
    return MaskGrid(perception.size[:2], perception.lower_m[:2], perception.upper_m[:2])


def source_names(names: SourceNames) -> list[SourceName]:
    """The names of one or several sources as a list. Raises UsageError for an empty list."""
    listed: list[SourceName] = [names] if isinstance(names, str | Path) else list(names)
    if not listed:
        raise UsageError("sources: expected at least one source; got none.")
    return listed


def open_sources(
    names: SourceNames,
    grid: MaskGrid | None = None,
    fast_decoding: Preprocessing | None = None,
    progress: Progress = no_progress,
) -> Source:
    """Open one or several sources as one, see `data.joined_source`. The history is reset between them.

    grid, progress: as for `open_source`.
    fast_decoding: decode JPEG files at a reduced size where that is enough for this preprocessing.
    Raises InputError if one of the sources does not exist.
    """
    opened = [open_source(name, grid, progress) for name in source_names(names)]
    if fast_decoding is not None:
        opened = [with_fast_decoding(source, fast_decoding) for source in opened]
    return join_sources(opened)


def with_fast_decoding(source: Source, preprocessing: Preprocessing) -> Source:
    """Return a source that decodes JPEG files at a reduced size where that is enough for a bundle's preprocessing.

    A source without image files is returned as it is.
    """
    return source.with_fast_decoding(preprocessing) if isinstance(source, ImageFiles) else source


def open_recording(name: str | Path, progress: Progress = no_progress) -> "Recording":
    """Open a source as `open_source` does, without validating its calibrations and times.

    Raises InputError if there is no such source, or its JSON cannot be read.
    """
    from ..rig.recording import FileRecording, SourceRecording  # here, because `rig` imports onnxruntime

    if str(name).startswith(SYNTHETIC):
        return SourceRecording(_open_drive(name))
    if str(name).startswith(NUSCENES):
        return FileRecording(_open_nuscenes(name, checked=False, progress=progress))
    return FileRecording(_open_folder(name, checked=False))


def source_path(name: str | Path) -> Path:
    """The path of a scene folder as a source. Other sources give a path that does not exist."""
    return Path(str(name).removeprefix(TRUSTED))


def _open_folder(name: str | Path, checked: bool = True) -> SceneFolder:
    return SceneFolder(source_path(name), checked, allow_outside_files=str(name).startswith(TRUSTED))


def _open_nuscenes(
    name: str | Path,
    checked: bool = True,
    progress: Progress = no_progress,
    grid: MaskGrid | None = None,
) -> "NuscenesSource":
    from ..data.nuscenes.nuscenes_source import NuscenesSource  # here, so that other sources do not wait for it

    return NuscenesSource(str(name).removeprefix(NUSCENES), checked, progress, grid)


def _open_drive(name: str | Path, grid: MaskGrid | None = None) -> "SyntheticDrive":
    from ..synthetic.drive import GRID, SyntheticDrive  # here, so that other sources do not wait for the renderer

    return SyntheticDrive.parse(str(name), GRID if grid is None else grid.size)
