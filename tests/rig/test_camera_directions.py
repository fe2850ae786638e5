"""Cameras that look in another direction than their names say, and swapped cameras."""

from itertools import combinations

import pytest

from duospacenet.rig.calibration import check_calibration
from duospacenet.rig.camera_directions import swapped_findings
from tests.helpers.rigs import AZIMUTHS_DEG, examine_source, level_camera, mount_position, write_rig

NUSCENES_DEG = {"FRONT": 0, "FRONT_LEFT": 55, "FRONT_RIGHT": -57, "BACK": 180, "BACK_LEFT": 108, "BACK_RIGHT": -112}


@pytest.mark.parametrize(
    ("one", "other"), [("FRONT", "FRONT_LEFT"), ("FRONT_RIGHT", "BACK_RIGHT"), ("BACK_LEFT", "BACK")]
)
def test_swapped_cameras_of_neighbouring_names_are_suspect(one, other):
    azimuths = NUSCENES_DEG | {one: NUSCENES_DEG[other], other: NUSCENES_DEG[one]}
    subjects = {name: swapped_subjects(azimuths, name) for name in azimuths}
    assert subjects[one] == [f"direction compared with {other}"]
    assert subjects[other] == [f"direction compared with {one}"]
    assert not any(subjects[name] for name in azimuths if name not in (one, other))


@pytest.mark.parametrize(
    "azimuths",
    [
        NUSCENES_DEG,
        {"LEFT": 0, "RIGHT": 0},  # a stereo pair
        {"LEFT_MIRROR": 150, "RIGHT_MIRROR": -150, "BACK_LEFT": 110, "BACK_RIGHT": -110},
        {"FRONT": 15, "FRONT_LEFT": 5},  # offsets of 55 degrees in sum, or 45 when swapped
        {"a": 90, "b": 0},
    ],
)
def test_cameras_that_are_not_swapped_have_no_finding(azimuths):
    assert not any(swapped_subjects(azimuths, name) for name in azimuths)


def swapped_subjects(azimuths, name):
    """The subjects of the findings about a camera and each other camera of a rig."""
    rig = {
        each: check_calibration(each, level_camera(azimuth, mount_position(azimuth)))
        for each, azimuth in azimuths.items()
    }
    findings = [each for pair in combinations(rig.values(), 2) for each in swapped_findings(*pair)]
    return [finding.subject for camera, finding in findings if camera == name]


def test_swapped_cameras_are_suspect_in_an_examination(tmp_path):
    def swap_front_and_left(scene):
        swapped = (
            level_camera(50, mount_position(50)).camera_T_ego.tolist(),
            level_camera(0, mount_position(0)).camera_T_ego.tolist(),
        )
        scene["cameras"]["FRONT"]["camera_T_ego"], scene["cameras"]["LEFT"]["camera_T_ego"] = swapped

    views = examine_source(write_rig(tmp_path / "rig", swap_front_and_left)).views
    assert [views[name].verdict for name in AZIMUTHS_DEG] == ["suspect", "suspect", "ok", "ok"]
    assert "50.0 degrees to the left, which fits the name LEFT better" in " ".join(map(str, views["FRONT"].findings))
