"""The example of a scene folder: it opens, it has every documented field, and it runs."""

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from duospacenet import jobs
from duospacenet.cli.main import run_app
from duospacenet.data.results import read_results
from duospacenet.data.scene_folder import SceneFolder
from duospacenet.data.scene_schema import BoxRecord, CalibrationRecord, CameraRecord, FrameRecord, SceneRecord
from examples.example_scene_folder import write_example

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "examples" / "scene_folder"
PAGE = ROOT / "docs" / "scene-folder.md"


@pytest.fixture(scope="module")
def scene() -> dict[str, Any]:
    return json.loads((FOLDER / "scene.json").read_text())


def used_fields(scene: dict[str, Any]) -> dict[type[BaseModel], set[str]]:
    """The fields that occur in the records of each kind."""
    frames = scene["frames"]
    records = {
        SceneRecord: [scene],
        CalibrationRecord: scene["cameras"].values(),
        FrameRecord: frames,
        CameraRecord: [camera for frame in frames for camera in frame["cameras"].values()],
        BoxRecord: [box for frame in frames for box in frame["boxes"] or ()],
    }
    return {kind: {field for record in each for field in record} for kind, each in records.items()}


def test_every_field_of_the_schema_occurs(scene):
    for kind, used in used_fields(scene).items():
        assert used == {info.alias or name for name, info in kind.model_fields.items()}, kind


def test_every_field_of_the_page_occurs(scene):
    table = re.search(r"^## Fields\n(.*?)^Unknown fields", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    assert table
    cells = [line.split("|")[1] for line in table[1].splitlines() if line.startswith("| `")]
    documented = {path.split(".")[-1] for cell in cells for path in re.findall(r"`([^`]+)`", cell)} - {"NAME"}
    assert len(documented) > 15
    assert documented <= set().union(*used_fields(scene).values())


def test_the_example_has_two_scenes_a_lost_camera_and_images_of_two_sizes(scene):
    source = SceneFolder(FOLDER)
    assert [source.scene_name(index) for index in range(len(source))] == ["scene-0061"] * 2 + ["scene-0103"] * 2
    assert [source.check_image_files(index) for index in range(4)] == [(), ("CAM_BACK_LEFT", "CAM_BACK_RIGHT"), (), ()]
    assert scene["frames"][1]["cameras"]["CAM_BACK_LEFT"]["image"] is None
    assert "CAM_BACK_RIGHT" not in scene["frames"][1]["cameras"]
    frames = list(source)
    assert frames[3].images["CAM_BACK"].shape == (45, 80, 3)
    assert frames[3].images["CAM_FRONT"].shape == (90, 160, 3)
    assert [source.has_maps(index) for index in range(4)] == [True, False, False, False]
    assert source.map_names(0) == frames[0].ground_truth.maps.keys() != set()
    assert [source.map_names(index) for index in (1, 2, 3)] == [set()] * 3
    assert [source.has_boxes(index) for index in range(4)] == [True, True, False, True]


def test_the_calibration_differs_from_frame_to_frame():
    """The ego vehicle drives on between the time stamp of the frame and those of the cameras."""
    poses = [frame.cameras["CAM_FRONT"].camera_T_ego for frame in SceneFolder(FOLDER)]
    for one, other in pairwise(poses):
        assert 1e-4 < np.abs(one - other).max() < 2


def test_the_boxes_have_attributes_points_and_mapped_names(scene):
    boxes = [box for frame in scene["frames"] for box in frame["boxes"] or ()]
    assert {"Car", "Person", "Cone"} <= {box["class"] for box in boxes}
    assert scene["class_mapping"] == {"Car": "car", "Person": "pedestrian", "Cone": None}
    assert {box["velocity_m_s"] is None for box in boxes} == {True, False}
    assert {box["attribute"] == "" for box in boxes} == {True, False}
    assert len({box["num_points"] for box in boxes}) > 5


def test_the_folder_is_small():
    sizes = [path.stat().st_size for path in FOLDER.rglob("*") if path.is_file()]
    assert len(sizes) == 24  # 22 images, a mask and scene.json
    assert sum(sizes) < 130_000


def test_the_script_writes_the_folder_again(scene, tmp_path):
    """The same files and the same fields. The values follow from the synthetic world."""
    write_example(tmp_path / "again")
    again = json.loads((tmp_path / "again" / "scene.json").read_text())
    assert used_fields(again) == used_fields(scene)
    assert [frame["scene"] for frame in again["frames"]] == [frame["scene"] for frame in scene["frames"]]
    files = [sorted(path.relative_to(folder) for path in folder.rglob("*")) for folder in (tmp_path / "again", FOLDER)]
    assert files[0] == files[1]


def test_the_tiny_preset_runs_on_it_and_is_evaluated(tiny_bundle, tmp_path, capfd):
    summary = jobs.run(tiny_bundle, FOLDER, tmp_path / "out", maps=True, formats="nuscenes")
    assert (summary.frames, summary.skipped) == (4, 0)
    assert all("2 of 24 images lost" in warning for warning in summary.warnings)
    results = list(read_results(tmp_path / "out" / "results.jsonl"))
    assert [result["history"]["frames"] for result in results] == [1, 2, 1, 2]
    assert all(len(result["boxes"]) > 0 for result in results)
    assert run_app(["eval", str(tiny_bundle), str(FOLDER)]) == 0
    assert "judged: boxes in 3 frames, drivable_area in 1 frame" in capfd.readouterr().out
