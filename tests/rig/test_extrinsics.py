"""Checks of extrinsics: which poses are ok, and which causes are reported for the others."""

from dataclasses import replace

import pytest

from duospacenet.rig import Verdict
from duospacenet.rig.calibration import check_calibration
from tests.helpers.rigs import change_extrinsics, examine_source, level_camera, mount_position, pitch, write_rig


@pytest.mark.parametrize("down_deg", [50, 60, 75, 90])
@pytest.mark.parametrize("azimuth_deg", [0, 90, 180, -90])
def test_an_upright_camera_that_looks_down_may_be_a_parking_camera(azimuth_deg, down_deg):
    camera = level_camera(azimuth_deg, mount_position(azimuth_deg))
    down = replace(camera, camera_T_ego=pitch(-down_deg) @ camera.camera_T_ego)
    (finding,) = check_calibration("a", down).findings
    assert finding.verdict is Verdict.SUSPECT
    assert finding.cause.startswith("This may be a parking camera")
    assert "quaternion" not in finding.cause
    assert f"looking {down_deg}.0 degrees down" in finding.got
    assert "nan" not in finding.got
    assert "-0.0 degrees" not in finding.got
    assert ("rolled" in finding.got) == (down_deg < 90)


@pytest.mark.parametrize("up_deg", [-40, -10, 10])
def test_a_camera_may_look_a_little_up_and_far_down(tmp_path, up_deg):
    damage = change_extrinsics("FRONT", lambda m: pitch(up_deg) @ m)
    assert examine_source(write_rig(tmp_path / "rig", damage)).verdict is Verdict.OK
