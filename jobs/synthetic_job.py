"""Writes scenes of the synthetic world as files: a nuScenes root, or a scene folder."""

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ..runtime.errors import UsageError
from ..runtime.frame import Frame
from ..runtime.progress import Progress, no_progress

NUSCENES = "nuscenes"
SCENE_FOLDER = "scene-folder"
FORMATS = (NUSCENES, SCENE_FOLDER)


@dataclass(frozen=True)
class SyntheticScenes:
    """The scenes that were written.

    source: the name under which other commands read them.
    scenes: their names.
    """

    source: str
    scenes: tuple[str, ...]
    frames_per_scene: int

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return asdict(self)


def write_synthetic(
    out: str | Path,
    scenes: int,
    frames: int,
    seed: int = 0,
    file_format: str = NUSCENES,
    split: str | None = None,
    image_width_px: int = 1600,
    progress: Progress = no_progress,
) -> SyntheticScenes:
    """Write scenes of the synthetic world to a new folder, which appears when all of them are written.

    scenes, frames: number of scenes, and of frames per scene.
    seed: of the first scene; each further scene has the next seed.
    file_format: one of `FORMATS`.
    split: of nuScenes; the scenes get the names of its first scenes. Only for the format "nuscenes".
    image_width_px: the height is 9/16 of it.

    Raises OutputError if `out` exists or cannot be written, and UsageError for a split with fewer scenes.
    """
    image_size = (image_width_px, image_width_px * 9 // 16)
    if file_format == SCENE_FOLDER:
        if split is not None:
            raise UsageError(
                "--split: expected with --format nuscenes only; a scene folder has no splits. Leave it out."
            )
        return _write_scene_folder(Path(out), range(seed, seed + scenes), frames, image_size, progress)
    from ..synthetic.nuscenes_root import write_nuscenes_root

    version = write_nuscenes_root(out, scenes, frames, seed, image_size, split, progress)
    return SyntheticScenes(f"nuscenes:{out}", version.scenes, frames)


def _write_scene_folder(
    out: Path, seeds: range, num_frames: int, image_size: tuple[int, int], progress: Progress
) -> SyntheticScenes:
    from ..data.scene_writer import write_scene
    from ..synthetic.drive import SyntheticDrive

    def frames() -> Iterator[Frame]:
        for seed in seeds:
            yield from SyntheticDrive(seed, num_frames, image_size)

    write_scene(out, progress(frames(), "rendering", len(seeds) * num_frames))
    return SyntheticScenes(str(out), tuple(f"synthetic-{seed}" for seed in seeds), num_frames)
