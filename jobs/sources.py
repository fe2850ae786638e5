"""Opening a source by its name: a scene folder, or `synthetic:SEED[:FRAMES]`."""

from pathlib import Path

from ..data.scene_folder import SceneFolder
from ..data.source import Source
from ..rig.recording import FolderRecording, Recording, SourceRecording
from ..synthetic.drive import GRID, SyntheticDrive


def open_source(name: str | Path, grid: tuple[int, int] | None = None) -> Source:
    """Open a scene folder or `synthetic:SEED[:FRAMES]`.

    grid: size (X, Y) in cells of a synthetic scene's map masks. A scene folder has its own.
    Raises InputError if there is no such source.
    """
    if str(name).startswith("synthetic:"):
        return SyntheticDrive.parse(str(name), grid or GRID)
    return SceneFolder(Path(name))


def open_recording(name: str | Path) -> Recording:
    """Open a source as `open_source` does, without validating its calibrations and times.

    Raises InputError if there is no such source, or its JSON cannot be read.
    """
    if str(name).startswith("synthetic:"):
        return SourceRecording(SyntheticDrive.parse(str(name)))
    return FolderRecording(SceneFolder(Path(name), checked=False))
