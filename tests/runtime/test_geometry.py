import numpy as np
import pytest

from duospacenet.runtime.geometry import (
    box_corners,
    image_T_ego,
    inverse,
    project,
    rigid_transform,
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
