"""The check of many calibrations accepts nothing that the check of a single one refuses."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.runtime.calibration_limits import are_intrinsics_possible, are_rigid
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.frame import Camera
from duospacenet.runtime.geometry import rigid_transform, rotation_z
from duospacenet.runtime.validation import check_camera

CAMERA = Camera(
    np.array([[800.0, 0, 400], [0, 800, 200], [0, 0, 1]]), rigid_transform(rotation_z(0.3), [1, 2, 3]), 800, 400
)


def is_accepted(camera):
    try:
        check_camera("front", camera)
    except InputError:
        return False
    return True


def random_camera(rng):
    """A camera that is wrong in no number, in one, or in several, by a little or by far."""
    intrinsics, extrinsics = CAMERA.intrinsics_px.copy(), CAMERA.camera_T_ego.copy()
    width, height = CAMERA.width_px, CAMERA.height_px
    for _ in range(rng.integers(3)):
        matrix = (intrinsics, extrinsics)[rng.integers(2)]
        place = tuple(rng.integers(matrix.shape))
        factor = rng.choice([0, -1, 0.999, 1.001, 1.0021, 0.05, 3, 100, 1e9, 1e200])
        matrix[place] = matrix[place] * factor + rng.choice([0, 0, 1e-3, -0.01, 1e10])
        if rng.random() < 0.1:
            width, height = rng.integers(0, 20000, 2).tolist()
    return replace(CAMERA, intrinsics_px=intrinsics, camera_T_ego=extrinsics, width_px=width, height_px=height)


@pytest.mark.filterwarnings("error::RuntimeWarning:duospacenet.runtime.calibration_limits")
def test_many_cameras_are_checked_as_single_ones():
    rng = np.random.default_rng(0)
    with np.errstate(all="ignore"):
        cameras = [random_camera(rng) for _ in range(2000)]
        expected = [is_accepted(camera) for camera in cameras]
    sizes = np.array([(camera.width_px, camera.height_px) for camera in cameras])
    possible = are_intrinsics_possible(np.array([camera.intrinsics_px for camera in cameras]), sizes)
    possible &= are_rigid(np.array([camera.camera_T_ego for camera in cameras]))
    assert possible.tolist() == expected
    assert 400 < sum(expected) < 1600
