"""Small scenes for tests of batches, and the results of `run` for each."""

from dataclasses import replace
from pathlib import Path

import pytest

from duospacenet import jobs
from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime.cores import available_cores
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.output_files import contents
from tests.helpers.streams import TINY_SIZE_PX, lose_cameras

NUM_FRAMES = 4


@pytest.fixture(scope="session")
def scene_folders(tmp_path_factory) -> list[Path]:
    """Four scene folders, each with the scene of its name; one loses a camera. Tests that change one make a copy."""
    folder = tmp_path_factory.mktemp("scenes")
    for number, name in enumerate(("city", "bridge", "tunnel", "park"), start=1):
        frames = list(SyntheticDrive(number, frames=NUM_FRAMES, image_size=TINY_SIZE_PX, grid=(16, 16)))
        frames = [replace(frame, scene=name, token=f"{name}-{index}") for index, frame in enumerate(frames)]
        if name == "tunnel":
            frames[1] = lose_cameras(frames[1], "CAM_BACK")
        write_scene(folder / name, frames)
    return [folder / name for name in ("city", "bridge", "tunnel", "park")]


@pytest.fixture(scope="session")
def run_of_each_scene(tiny_bundle, scene_folders, tmp_path_factory) -> dict[str, dict[str, bytes]]:
    """The files that `run` writes for each scene alone, by the scene's name."""
    out = tmp_path_factory.mktemp("runs")
    for scene in scene_folders:
        jobs.run(tiny_bundle, scene, out / scene.name, maps=True, threads=available_cores())
    return {scene.name: contents(out / scene.name) for scene in scene_folders}
