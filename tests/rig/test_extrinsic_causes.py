"""Likely causes of wrong extrinsics."""

import numpy as np
import pytest

from duospacenet.rig.extrinsic_causes import likely_causes
from duospacenet.runtime.geometry import inverse, rigid_transform
from tests.helpers.rigs import level_camera


def test_an_inverted_matrix_has_only_the_inversion_as_its_likely_cause():
    assert likely_causes(np.linalg.inv(level_camera(0, (1.7, 0, 1.5)).camera_T_ego)) == [
        "the matrix is ego_T_camera, the inverse of camera_T_ego"
    ]


@pytest.mark.parametrize("azimuth_deg", range(-150, 180, 30))
def test_a_transposed_rotation_is_recognised_in_every_direction(azimuth_deg):
    ego_T_camera = inverse(level_camera(azimuth_deg, (1.2, 0.4, 1.5)).camera_T_ego)
    wrong = inverse(rigid_transform(ego_T_camera[:3, :3].T, ego_T_camera[:3, 3]))
    assert "the rotation is transposed" in likely_causes(wrong)
