"""Writes scenes of the synthetic world as a nuScenes root."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ...data.images import write_png
from ...runtime.errors import OutputError
from ...runtime.files import atomic_folder
from ...runtime.progress import Progress, no_progress
from .root_scene import RootScene, SceneFrame
from .root_tables import RootTables, make_token
from .scene_names import RootVersion, choose_version
from .scene_rows import SceneRows
from .sensor_rows import add_sensors

LOCATIONS = ("boston-seaport", "singapore-hollandvillage", "singapore-onenorth", "singapore-queenstown")
FRAMES_PER_SCENE = 40
IMAGE_SIZE = (1600, 900)


def write_nuscenes_root(
    out: Path | str,
    num_scenes: int,
    num_frames: int = FRAMES_PER_SCENE,
    seed: int = 0,
    image_size: tuple[int, int] = IMAGE_SIZE,
    split: str | None = None,
    progress: Progress = no_progress,
) -> RootVersion:
    """Write scenes of the synthetic world as a nuScenes root: tables and images.

    out: a new folder. It appears only when everything is written.
    num_frames: key frames per scene, at 2 Hz.
    seed: of the first scene; each further scene has the next seed.
    image_size: width and height [px]; nuScenes has 1600x900.
    split: the split of nuScenes whose scene names are used; see `choose_version`.

    Returns the version and the names of the scenes. Raises OutputError if `out` exists or cannot be written, and
    UsageError for a split with fewer scenes. Nothing remains on disk then.
    """
    out = Path(out)
    version = choose_version(num_scenes, split)
    if out.exists() or out.is_symlink():
        raise OutputError(f"{out}: expected a new folder; it exists already. Remove it, or choose another.")
    with atomic_folder(out) as folder:
        tables = RootTables()
        add_sensors(tables)
        scenes = (
            SceneRows(tables, folder, name, RootScene(seed + number, num_frames, image_size))
            for number, name in enumerate(version.scenes)
        )
        frames = _frames_of_all(scenes)
        log_tokens: dict[str, list[str]] = {location: [] for location in LOCATIONS}
        for rows, index, frame in progress(frames, "synthetic", num_scenes * num_frames):
            rows.add_frame(index, frame)
            if index + 1 == num_frames:
                location = LOCATIONS[version.scenes.index(rows.name) % len(LOCATIONS)]
                log_tokens[location].append(rows.finish(location, version.has_annotations))
        _add_maps(tables, folder, {location: tokens for location, tokens in log_tokens.items() if tokens})
        (folder / version.name).mkdir()
        tables.write(folder / version.name)
    return version


def _frames_of_all(scenes: Iterator[SceneRows]) -> Iterator[tuple[SceneRows, int, SceneFrame]]:
    """Each frame of each scene with its index in the scene."""
    for rows in scenes:
        for index, frame in enumerate(rows.scene.frames()):
            yield rows, index, frame


def _add_maps(tables: RootTables, folder: Path, log_tokens: dict[str, list[str]]) -> None:
    """Add a row of the table `map` per location.

    Its picture is an older kind of map, which the map expansion has replaced. It must be there for the devkit to open
    the root, but has only one pixel.
    """
    (folder / "maps").mkdir()
    for location, tokens in log_tokens.items():
        token = make_token("map", location)
        write_png(folder / "maps" / f"{token}.png", np.zeros((1, 1), np.uint8))
        tables.add("map", token=token, category="semantic_prior", filename=f"maps/{token}.png", log_tokens=tokens)
