"""RELIABILITY row T12: class names of ground truth that no model of nuScenes' classes knows."""

import json

import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.streams import TINY_SIZE_PX
from tests.helpers.train_command import TRAIN_TINY

BAD_INPUT = 3
NAMES = (
    "Car",
    "Vehicle.Car",
    "vehicle.Car",
    "cars",
    " car",
    "Pedestrian",
    "person",
    "TYPE_VEHICLE",
    "1",
)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """A rendered frame and the index of a car in it."""
    folder = tmp_path_factory.mktemp("names") / "scene"
    write_scene(folder, SyntheticDrive(3, frames=1, image_size=TINY_SIZE_PX, grid=(16, 16)))
    (frame,) = json.loads((folder / "scene.json").read_text())["frames"]
    return folder, [box["class"] for box in frame["boxes"]].index("car")


def rename_box(scene, name):
    """Rename one box among known ones. Returns the folder."""
    folder, index = scene
    content = json.loads((folder / "scene.json").read_text())
    content["frames"][0]["boxes"][index]["class"] = name
    (folder / "scene.json").write_text(json.dumps(content))
    return str(folder)


@pytest.mark.parametrize("name", NAMES)
def test_t12_a_single_unknown_name_is_refused_by_every_command_that_needs_boxes(
    tiny_bundle, scene, tmp_path, capfd, name
):
    folder = rename_box(scene, name)
    for command in (
        ["eval", str(tiny_bundle), folder],
        ["anchors", folder, "--queries", "2", "--out", str(tmp_path / "anchors.json")],
        [*TRAIN_TINY, "--source", folder, "--out", str(tmp_path / "training")],
    ):
        assert run_app(command) == BAD_INPUT
        printed = capfd.readouterr()
        assert f"got {name!r} (1 box). Rename" in " ".join(printed.err.split("\n"))
        assert printed.out == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["vehicle.car", "DontCare", "animal", "static_object.bicycle_rack"])
def test_t12_a_known_name_is_accepted(scene, tmp_path, name):
    assert run_app(["anchors", rename_box(scene, name), "--queries", "2", "--out", str(tmp_path / "a.json")]) == 0
