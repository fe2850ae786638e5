"""Writes scenes of the synthetic world as a nuScenes root."""

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from ...data.images import write_png
from ...runtime.errors import OutputError
from ...runtime.files import atomic_folder
from ...runtime.progress import Progress, no_progress
from .map_layers import MapLayers
from .map_layout import MapLayout, Place
from .road_map import RoadMap
from .root_scene import RootScene, SceneFrame
from .root_tables import RootTables, make_token
from .scene_names import RootVersion, choose_version
from .scene_rows import SceneRows
from .sensor_rows import add_sensors

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
    """Write scenes of the synthetic world as a nuScenes root: tables, images and maps.

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
        (folder / version.name).mkdir()
        tables = RootTables(folder / version.name)
        add_sensors(tables)
        layout = MapLayout()
        places = [layout.place(number, seed + number, num_frames) for number in range(num_scenes)]
        scenes = (
            SceneRows(tables, folder, name, RootScene(seed + number, num_frames, image_size, place), place.location)
            for number, (name, place) in enumerate(zip(version.scenes, places, strict=True))
        )
        for rows, index, frame in progress(_frames_of_all(scenes), "rendering", num_scenes * num_frames):
            rows.add_frame(index, frame)
            if index + 1 == num_frames:
                rows.finish(version.has_annotations)
                tables.flush()
        _write_maps(tables, folder, layout, dict(zip(version.scenes, places, strict=True)))
        tables.close()
    return version


def _frames_of_all(scenes: Iterator[SceneRows]) -> Iterator[tuple[SceneRows, int, SceneFrame]]:
    """Each frame of each scene with its index in the scene."""
    for rows in scenes:
        for index, frame in enumerate(rows.scene.frames()):
            yield rows, index, frame


def _write_maps(tables: RootTables, folder: Path, layout: MapLayout, places: Mapping[str, Place]) -> None:
    """Write the map expansion of each location that has scenes, and add its row of the table `map`.

    places: of the scenes, by name.

    The picture of that row is an older kind of map. nuscenes-devkit 1.2.0 opens no root without it, but it has only
    one pixel here.
    """
    (folder / "maps" / "expansion").mkdir(parents=True)
    for location in sorted({place.location for place in places.values()}):
        layers, logs = MapLayers(location), []
        for name, place in places.items():
            if place.location == location:
                RoadMap(layers, place.road, place.origin_m, *place.ends_m).add()
                logs.append(make_token("log", name))
        layers.write(folder / "maps" / "expansion" / f"{location}.json", layout.canvas_m(location))
        token = make_token("map", location)
        write_png(folder / "maps" / f"{token}.png", np.zeros((1, 1), np.uint8))
        tables.add("map", token=token, category="semantic_prior", filename=f"maps/{token}.png", log_tokens=logs)
