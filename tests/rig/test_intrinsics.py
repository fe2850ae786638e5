"""Checks of intrinsics: a wrong resolution is found at any scale, and principal points of real lenses are ok."""

import re
from dataclasses import replace

import numpy as np
import pytest

from duospacenet.jobs.sources import open_recording
from duospacenet.rig import Verdict
from duospacenet.rig.calibration import check_calibration
from examples.nuscenes_scene import has_data, write_scene_folder
from tests.helpers.rigs import level_camera

RESIZE_FACTORS = [0.6, 2 / 3, 0.75, 0.8, 1.25]


@pytest.mark.parametrize("factor", RESIZE_FACTORS)
def test_intrinsics_of_another_resolution_are_suspect_at_any_scale(factor):
    """The front camera of nuScenes: its principal point is 2 % and 9 % of the half size off the centre."""
    lens = np.array([[1266.417, 0, 816.267], [0, 1266.417, 491.507], [0, 0, 1]])
    camera = level_camera(0, width_px=1600, height_px=900, intrinsics_px=lens)
    assert check_calibration("FRONT", camera).findings == ()
    resized = replace(camera, intrinsics_px=np.diag([factor, factor, 1]) @ lens)
    (finding,) = check_calibration("FRONT", resized).findings
    assert finding.verdict is Verdict.SUSPECT
    match = re.search(
        r"belong to another resolution, about (\d+)x(\d+) px, ([0-9.]+) times the 1600x900 px", finding.cause
    )
    assert [float(number) for number in match.groups()] == pytest.approx(
        [1600 * factor, 900 * factor, factor], rel=0.08, abs=0.005
    )


def test_principal_points_of_synthetic_rigs_are_ok():
    for seed in range(40):
        for name, camera in open_recording(f"synthetic:{seed}:1").frame_without_images(0).cameras.items():
            assert check_calibration(name, camera).findings == ()


@pytest.mark.skipif(not has_data(), reason="the nuScenes frames are not beside this checkout")
@pytest.mark.parametrize("factor", RESIZE_FACTORS)
def test_intrinsics_of_another_resolution_are_suspect_for_every_camera_of_the_real_rig(tmp_path, factor):
    for name, camera in (
        open_recording(str(write_scene_folder(tmp_path / "scene"))).frame_without_images(0).cameras.items()
    ):
        resized = replace(camera, intrinsics_px=np.diag([factor, factor, 1]) @ camera.intrinsics_px)
        assert "belong to another resolution" in " ".join(map(str, check_calibration(name, resized).findings))
