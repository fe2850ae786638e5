import numpy as np
import pytest

from duospacenet.synthetic.nuscenes_rig import build_rig


def test_the_rig_is_the_nuscenes_rig_scaled_and_cropped_at_the_top():
    yaws_deg = {"CAM_FRONT": 0, "CAM_FRONT_RIGHT": -55, "CAM_FRONT_LEFT": 55, "CAM_BACK": 180, "CAM_BACK_LEFT": 110,
                "CAM_BACK_RIGHT": -110}  # fmt: skip
    for size, focal, centre in (((400, 160), 316.5, (200, 57.75)), ((800, 320), 633.0, (400, 115.5))):
        cameras = build_rig(4, size)
        assert cameras.keys() == yaws_deg.keys()
        for name, camera in cameras.items():
            expected = focal * 809 / 1266 if name == "CAM_BACK" else focal
            assert camera.intrinsics_px[0, 0] == pytest.approx(expected, rel=0.016)
            assert camera.intrinsics_px[:2, 2] == pytest.approx(centre, abs=0.007 * size[0])
            ahead = camera.camera_T_ego[2, :3]
            deviation = np.arctan2(ahead[1], ahead[0]) - np.radians(yaws_deg[name])
            assert abs((deviation + np.pi) % (2 * np.pi) - np.pi) < np.radians(2.1)
            assert abs(ahead[2]) < np.radians(1.5)
            assert np.linalg.det(camera.camera_T_ego[:3, :3]) == pytest.approx(1.0)
