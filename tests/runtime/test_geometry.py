import numpy as np
import pytest

from duospacenet.runtime.geometry import (
    CAMERA_R_BODY,
    box_corners,
    image_T_ego,
    inverse,
    nearest_rigid,
    project,
    rigid_transform,
    rotation_angle,
    rotation_from_quaternion,
    rotation_z,
    transform,
)

# A camera at the origin of the ego frame that looks forward: camera x is -y, camera y is -z, camera z is x.
LOOKING_FORWARD = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
INTRINSICS = np.array([[100, 0, 80], [0, 50, 32], [0, 0, 1.0]])


def test_a_quarter_turn_about_z_takes_x_to_y():
    np.testing.assert_allclose(rotation_z(np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(rotation_z(np.pi / 2) @ [0, 1, 5], [-1, 0, 5], atol=1e-15)


def test_a_transform_rotates_first_and_then_translates():
    # The ego is at (10, 20, 0), heading along y. A point 2 m ahead is at (10, 22), one 1 m to the left at (9, 20).
    global_T_ego = rigid_transform(rotation_z(np.pi / 2), [10, 20, 0])
    points = transform(global_T_ego, np.array([[[2.0, 0, 0]], [[0, 1.0, 3]]]))
    np.testing.assert_allclose(points, [[[10, 22, 0]], [[9, 20, 3]]], atol=1e-14)


def test_the_inverse_is_the_matrix_inverse_for_one_transform_and_for_a_batch():
    rng = np.random.default_rng(0)
    rotations = np.linalg.qr(rng.normal(size=(5, 3, 3)))[0]
    batch = np.stack([rigid_transform(rotation, rng.normal(size=3) * 100) for rotation in rotations])
    np.testing.assert_allclose(inverse(batch), np.linalg.inv(batch), atol=1e-12)
    np.testing.assert_allclose(inverse(batch[0]), np.linalg.inv(batch[0]), atol=1e-12)


def test_relative_poses_far_from_the_origin_keep_their_precision():
    far = rigid_transform(rotation_z(0.3), [5e6, 5e6, 0])
    near = rigid_transform(rotation_z(0.4), [5e6 + 3, 5e6, 0])
    expected = rigid_transform(rotation_z(0.1), rotation_z(-0.3) @ [3, 0, 0])
    np.testing.assert_allclose(inverse(far) @ near, expected, atol=2e-9)


def test_a_point_is_projected_by_the_pinhole_model():
    # 10 m ahead, 2 m to the left, 1 m up: u = 80 - 100 * 2 / 10, v = 32 - 50 * 1 / 10.
    pixels, depth_m = project(np.array([[10.0, 2, 1]]), image_T_ego(INTRINSICS, LOOKING_FORWARD))
    np.testing.assert_allclose(pixels, [[60, 27]])
    np.testing.assert_allclose(depth_m, [10])


def test_the_position_and_direction_of_the_camera_are_used_in_a_projection():
    # The camera is 2 m to the left of the ego and 1.5 m up, and looks left: camera x is x, camera z is y.
    looking_left = np.array([[1, 0, 0, 0], [0, 0, -1, 1.5], [0, 1, 0, -2], [0, 0, 0, 1.0]])
    pixels, depth_m = project(np.array([3.0, 7.0, 0.5]), image_T_ego(INTRINSICS, looking_left))
    np.testing.assert_allclose(pixels, [80 + 100 * 3 / 5, 32 + 50 * 1 / 5])
    np.testing.assert_allclose(depth_m, 5)


def test_points_behind_the_camera_have_negative_depth_and_finite_pixels():
    pixels, depth_m = project(np.array([[-5.0, 1, 1], [0, 1, 1]]), image_T_ego(INTRINSICS, LOOKING_FORWARD))
    np.testing.assert_allclose(depth_m, [-5, 0])
    assert np.isfinite(pixels).all()


def test_corners_start_at_front_left_of_the_bottom_and_continue_with_the_top():
    # At (10, 0, 1): 2 m wide, 4 m long, 1 m high, heading along y: front is +y, left is -x.
    corners = box_corners(np.array([[10, 0, 1, 2, 4, 1, np.pi / 2, 0, 0]]))
    bottom = [(9, 2), (11, 2), (11, -2), (9, -2)]
    expected = [(x, y, 0.5) for x, y in bottom] + [(x, y, 1.5) for x, y in bottom]
    np.testing.assert_allclose(corners, [expected], atol=1e-14)


@pytest.mark.parametrize("boxes", [np.zeros((0, 9)), []])
def test_an_empty_list_of_boxes_gives_no_corners(boxes):
    assert box_corners(boxes).shape == (0, 8, 3)


def test_the_axes_of_a_camera_are_those_of_a_body_that_looks_forward():
    """Right is the negative left, down the negative up, and the view direction is forward."""
    forward, left, up = np.eye(3)
    assert (CAMERA_R_BODY @ forward).tolist() == [0, 0, 1]
    assert (CAMERA_R_BODY @ -left).tolist() == [1, 0, 0]
    assert (CAMERA_R_BODY @ -up).tolist() == [0, 1, 0]


@pytest.mark.parametrize("angle_rad", [0.0, 1e-3, 0.7, np.pi / 2, 3.0, np.pi])
def test_the_angle_of_a_rotation_does_not_depend_on_its_axis_and_sign(angle_rad):
    turn = rotation_z(angle_rad)
    tilt = rotation_from_quaternion(np.array([0.5, 0.5, -0.5, 0.5]))
    for rotation in (turn, turn.T, tilt @ turn @ tilt.T):
        angle = rotation_angle(rotation)
        assert type(angle) is float
        assert angle == pytest.approx(angle_rad, abs=1e-7)


def test_the_angle_is_not_nan_if_rounding_makes_the_trace_too_large_or_too_small():
    assert rotation_angle(np.eye(3) * (1 + 1e-15)) == 0
    assert rotation_angle(np.diag([-1.0, -1, 1]) - 1e-15 * np.eye(3)) == pytest.approx(np.pi)


def test_the_nearest_rotation_removes_a_stretch_and_keeps_the_translation():
    """The polar decomposition: a rotation times a symmetric positive stretch gives back the rotation."""
    rotation = rotation_z(0.4) @ rotation_from_quaternion(np.array([0.8, 0.6, 0, 0]))
    stretch = np.array([[1.01, 2e-3, 0], [2e-3, 0.99, -1e-3], [0, -1e-3, 1.002]])
    rigid = nearest_rigid(rigid_transform(rotation @ stretch, [3, -4, 5e6]))
    np.testing.assert_allclose(rigid[:3, :3], rotation, atol=1e-12)
    np.testing.assert_array_equal(rigid[:, 3], [3, -4, 5e6, 1])
    np.testing.assert_array_equal(rigid[3], [0, 0, 0, 1])
