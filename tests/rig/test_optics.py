"""Angles and poses of one camera, in cases worked by hand."""

import numpy as np
import pytest

from duospacenet.rig.optics import camera_pose, field_of_view, orthonormality_error, principal_point_fraction
from tests.helpers.rigs import level_camera


def test_a_focal_length_of_half_the_width_gives_90_degrees():
    # The rays through two opposite corners are (1, 0.5, 1) and (-1, -0.5, 1). Their cosine is -0.25 / 2.25.
    angles = field_of_view(level_camera(0))
    assert angles.horizontal == pytest.approx(90)
    assert angles.vertical == pytest.approx(2 * np.degrees(np.arctan(0.5)))
    assert angles.diagonal == pytest.approx(np.degrees(np.arccos(-1 / 9)))


def test_a_principal_point_on_the_left_border_gives_half_the_angle():
    camera = level_camera(0, intrinsics_px=np.array([[160.0, 0, 0], [0, 80, 40], [0, 0, 1]]))
    assert field_of_view(camera).horizontal == pytest.approx(45)
    assert principal_point_fraction(camera) == (0.0, 0.5)


def test_skew_increases_the_vertical_angle():
    # The ray through the top middle is (1, -1, 1), that through the bottom middle (-1, 1, 1). Their cosine is -1 / 3.
    camera = level_camera(
        0, intrinsics_px=np.array([[100.0, 100, 50], [0, 100, 100], [0, 0, 1]]), width_px=100, height_px=200
    )
    assert field_of_view(camera).vertical == pytest.approx(np.degrees(np.arccos(-1 / 3)))


@pytest.mark.parametrize("azimuth_deg", [0, 37, 90, 145, -20, -90])
def test_the_pose_of_a_level_camera_has_its_azimuth_and_position(azimuth_deg):
    pose = camera_pose(level_camera(azimuth_deg, (1.7, -0.3, 1.4)).camera_T_ego)
    np.testing.assert_allclose(pose.position_m, [1.7, -0.3, 1.4], atol=1e-12)
    assert pose.azimuth_deg == pytest.approx(azimuth_deg)
    assert pose.elevation_deg == pytest.approx(0, abs=1e-9)
    assert pose.roll_deg == pytest.approx(0, abs=1e-9)


def rotate_camera(axis, degrees):
    """(4, 4) the rotation of a camera about its own x axis (pitch) or z axis (roll), to multiply from the left."""
    cos, sin = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    matrix = np.eye(4)
    matrix[:3, :3] = {"x": [[1, 0, 0], [0, cos, sin], [0, -sin, cos]], "z": [[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]}[
        axis
    ]
    return matrix


def test_elevation_is_positive_upward_and_roll_is_positive_clockwise():
    # A rotation about x moves the optical axis z towards -y, which is up. One about z moves right towards down.
    up = camera_pose(rotate_camera("x", 20) @ level_camera(90).camera_T_ego)
    assert (up.azimuth_deg, up.elevation_deg, up.roll_deg) == pytest.approx((90, 20, 0))
    rolled = camera_pose(rotate_camera("z", 30) @ level_camera(90).camera_T_ego)
    assert (rolled.azimuth_deg, rolled.elevation_deg, rolled.roll_deg) == pytest.approx((90, 0, 30))


def test_a_camera_that_looks_straight_up_has_no_roll():
    straight_up = camera_pose(rotate_camera("x", 90) @ level_camera(0).camera_T_ego)
    assert straight_up.elevation_deg == pytest.approx(90)
    assert np.isnan(straight_up.roll_deg)


def test_a_singular_matrix_gives_nan_and_no_exception():
    assert np.isnan(camera_pose(np.zeros((4, 4))).position_m).all()
    singular = level_camera(0, intrinsics_px=np.zeros((3, 3)))
    assert np.isnan(field_of_view(singular)).all()


def test_the_orthonormality_error_is_the_largest_element_of_its_gram_matrix_minus_identity():
    assert orthonormality_error(np.diag([1.0, 1.0, 2.0])) == 3.0
