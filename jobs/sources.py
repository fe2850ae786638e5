"""Sources by their words on the command line: a scene folder, or `synthetic:SEED[:FRAMES]`."""

from pathlib import Path

from ..data.scene_folder import SceneFolder
from ..data.source import Source
from ..rig.recording import FolderRecording, Recording, SourceRecording
from ..synthetic.drive import GRID, SyntheticDrive


def open_source(spec: str, grid: tuple[int, int] | None = None) -> Source:
    """Open `synthetic:SEED[:FRAMES]` or a scene folder.

    grid: cells of the map masks of a drawn drive; a folder has its own. Raises InputError when there is no such source.
    """
    if spec.startswith("synthetic:"):
        return SyntheticDrive.parse(spec, grid or GRID)
    return SceneFolder(Path(spec))


def open_recording(spec: str) -> Recording:
    """Open a source as `open_source` does, but unchecked. Raises InputError where it is none, or its JSON is broken."""
    if spec.startswith("synthetic:"):
        return SourceRecording(SyntheticDrive.parse(spec))
    return FolderRecording(SceneFolder(Path(spec), checked=False))
