"""`check-rig` names the cause of each mistake of the catalogue, and has no finding about right rigs."""

import json
import os
import re

import numpy as np
import pytest

from duospacenet.cli.main import run_app
from examples.nuscenes_scene import has_data
from tests.rig.mistake_scenes import copy_with_mistake, write_base
from tests.rig.mistake_table import report_of, try_mistake
from tests.rig.mistakes import MISTAKES

# `make reliability` tries all mistakes. Each takes up to several seconds, so the normal suite tries one of each kind.
TRY_ALL = "DUOSPACENET_ALL_MISTAKES" in os.environ
# These hardly differ from the right numbers in a drive on a straight road, as this one.
UNDECIDED = ["yaw to the right", "headings in degrees"]
ONE_OF_EACH_KIND = [
    "extrinsics inverted, one",
    "translation is the position, all",
    "centimetres, one",
    "camera axes of OpenGL, all",
    "quaternion x y z w, all",
    "degrees as radians, all",
    "ego origin on the roof",
    "cx and cy exchanged, one",
    "intrinsics of half the size, all",
    "intrinsics normalised, all",
    "one calibration twice",
    "left and right images exchanged",
    "one camera lost",
    "times in ms",
    "slow rig",
    "frames in reverse order",
    "positions in mm",
    "poses inverted",
    "headings read as degrees",
    "yaw in degrees",
    "sizes as l h w",
    "boxes in camera axes",
    "bottom centres",
    "unknown class names",
]
TRIED = [name for name in MISTAKES if name not in UNDECIDED] if TRY_ALL else ONE_OF_EACH_KIND
OTHER_RIGS = ["numbered", "five", "seven"] if TRY_ALL else ["numbered"]
ON_REAL_IMAGES = ["one camera yawed", "left and right images exchanged"]
SEED = 3


@pytest.fixture(scope="module")
def base(tmp_path_factory):
    """A scene folder of the synthetic rig without a mistake."""
    return write_base(tmp_path_factory.mktemp("rig") / "base", "nuscenes", SEED)


@pytest.mark.parametrize("name", TRIED)
def test_t10_check_rig_names_the_cause_of_a_mistake(base, tmp_path, name):
    outcome, text = try_mistake(MISTAKES[name], base, tmp_path / "copy", SEED)
    # Another cause may be named beside the right one, if the numbers fit both.
    assert outcome != "missed", text
    assert re.search(MISTAKES[name].cause, text), text


@pytest.mark.skipif(not TRY_ALL, reason="`make reliability` runs this test")
@pytest.mark.skipif(not has_data(), reason="the nuScenes frames are not beside this checkout")
@pytest.mark.parametrize("name", ON_REAL_IMAGES)
def test_t10_check_rig_names_the_cause_of_a_mistake_on_real_images(tmp_path, name):
    outcome, text = try_mistake(MISTAKES[name], write_base(tmp_path / "base", "real", 0), tmp_path / "copy", 1)
    assert outcome == "right", text


def test_t10_check_rig_has_no_finding_about_a_right_rig(base):
    report = report_of(base)
    assert report["verdict"] == report["ground_truth"]["verdict"] == report["drive"]["verdict"] == "ok"
    assert report["diagnoses"] == []


@pytest.mark.parametrize("rig", OTHER_RIGS)
def test_t10_check_rig_has_no_finding_about_other_rigs(tmp_path, rig):
    report = report_of(write_base(tmp_path / rig, rig, 4, num_frames=3))
    assert report["verdict"] == "ok", report["diagnoses"]


def park(record, rng):
    for frame in record["frames"]:
        frame.update(global_T_ego=record["frames"][0]["global_T_ego"], cameras=record["frames"][0]["cameras"])


def lose_cameras(record, rng):
    for cameras in (record["cameras"], *(frame["cameras"] for frame in record["frames"])):
        for name in ("CAM_BACK", "CAM_BACK_LEFT"):
            del cameras[name]


@pytest.mark.parametrize(("change", "drive"), [(park, "not judged"), (lose_cameras, "ok")])
def test_t10_unusual_recordings_are_not_suspect(base, tmp_path, change, drive):
    record = json.loads((base / "scene.json").read_text())
    change(record, np.random.default_rng(0))
    for frame in record["frames"]:
        frame["boxes"] = None
    report = report_of(copy_with_mistake(base, tmp_path / "copy", record))
    assert report["verdict"] == "ok", report
    assert report["drive"]["verdict"] == drive


def test_t10_strict_exits_with_1_for_a_suspect_rig(base, tmp_path, capfd):
    record = json.loads((base / "scene.json").read_text())
    for index, frame in enumerate(record["frames"]):
        frame["timestamp_s"] = 3.0 * index
    folder = copy_with_mistake(base, tmp_path / "copy", record)
    command = ["check-rig", str(folder), "--out", str(tmp_path / "out"), "--frames", "1"]
    assert run_app(command) == 0
    assert run_app([*command, "--overwrite", "--strict"]) == 1
    assert "suspect: the drive" in capfd.readouterr().err
