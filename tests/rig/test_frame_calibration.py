"""The calibrations of one frame are judged by themselves, with one cause for cameras that share it."""

import numpy as np
import pytest

from duospacenet.rig import Verdict, judge_calibration
from duospacenet.runtime.geometry import inverse, rigid_transform
from duospacenet.synthetic.nuscenes_rig import build_rig
from tests.helpers.rigs import AZIMUTHS_DEG, level_camera, mount_position


def change_all(change):
    """The rig of a synthetic drive, with the extrinsics of all its cameras changed."""
    return {
        name: type(camera)(camera.intrinsics_px, change(camera.camera_T_ego), camera.width_px, camera.height_px)
        for name, camera in build_rig(3, (400, 160)).items()
    }


def without_names(cameras):
    return {f"CAMERA_{number:02}": camera for number, camera in enumerate(cameras.values())}


def scale_translation(factor):
    return lambda matrix: rigid_transform(matrix[:3, :3], matrix[:3, 3] * factor)


SHARED = {
    "inverted": (inverse, "the matrix is ego_T_camera"),
    "position as translation": (lambda m: rigid_transform(m[:3, :3], inverse(m)[:3, 3]), "the camera's position"),
    "millimetres": (scale_translation(1000), "in millimetres"),
    "centimetres": (scale_translation(100), "in centimetres"),
    "inches": (scale_translation(1 / 0.0254), "in inches"),
    "roof": (lambda m: m @ rigid_transform(np.eye(3), [0, 0, 1.9]), "the ego origin is on the roof"),
}


@pytest.mark.parametrize("case", SHARED)
@pytest.mark.parametrize("rename", [dict, without_names])
def test_a_mistake_in_all_cameras_is_the_only_cause_of_each(case, rename):
    change, text = SHARED[case]
    judged = judge_calibration(rename(change_all(change)))
    causes = {finding.cause for findings in judged.findings.values() for finding in findings}
    assert len(causes) == 1, causes
    assert text in causes.pop()
    assert "; or " not in str(causes)
    assert judged.verdict is Verdict.BROKEN
    assert all(judged.findings.values())


def test_a_right_rig_has_no_findings():
    for seed in range(21):
        judged = judge_calibration(build_rig(seed, (400, 160)))
        assert judged.verdict is Verdict.OK
        assert not any(judged.findings.values())


def test_a_mistake_in_one_camera_is_not_attributed_to_the_others():
    cameras = {name: level_camera(azimuth, mount_position(azimuth)) for name, azimuth in AZIMUTHS_DEG.items()}
    front = cameras["FRONT"]
    cameras["FRONT"] = type(front)(
        front.intrinsics_px, scale_translation(100)(front.camera_T_ego), front.width_px, front.height_px
    )
    judged = judge_calibration(cameras)
    assert [len(findings) for findings in judged.findings.values()] == [1, 0, 0, 0]
    assert "in centimetres" in judged.findings["FRONT"][0].cause


@pytest.mark.parametrize("seed", range(8))
def test_the_inverse_of_any_single_camera_is_broken(seed):
    """The position of the inverted camera at the back may be a few centimetres above the road."""
    for name, camera in build_rig(seed, (400, 160)).items():
        inverted = type(camera)(camera.intrinsics_px, inverse(camera.camera_T_ego), camera.width_px, camera.height_px)
        judged = judge_calibration(build_rig(seed, (400, 160)) | {name: inverted})
        assert [each for each in judged.findings if judged.findings[each]] == [name]
        assert judged.verdict is Verdict.BROKEN
        assert "ego_T_camera" in judged.findings[name][0].cause
