import numpy as np
import pytest

from duospacenet.runtime.geometry import box_corners, image_T_ego, inverse, project, rigid, rotation_z, transform

# At the ego's origin, looking ahead: x right is y left negated, y down is z up negated, z is x.
AHEAD = np.array([[0, -1, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0, 0, 0, 1.0]])
INTRINSICS = np.array([[100, 0, 80], [0, 50, 32], [0, 0, 1.0]])


def test_a_quarter_turn_about_z_takes_x_to_y():
    np.testing.assert_allclose(rotation_z(np.pi / 2) @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(rotation_z(np.pi / 2) @ [0, 1, 5], [-1, 0, 5], atol=1e-15)


def test_a_transform_turns_first_and_then_shifts():
    # The ego stands at (10, 20, 0) and looks along y: what is 2 m ahead is at (10, 22), 1 m to its left at (9, 20).
    global_T_ego = rigid(rotation_z(np.pi / 2), [10, 20, 0])
    points = transform(global_T_ego, np.array([[[2.0, 0, 0]], [[0, 1.0, 3]]]))
    np.testing.assert_allclose(points, [[[10, 22, 0]], [[9, 20, 3]]], atol=1e-14)


def test_the_inverse_is_the_matrix_inverse_for_one_and_for_many():
    rng = np.random.default_rng(0)
    rotations = np.linalg.qr(rng.normal(size=(5, 3, 3)))[0]
    many = np.stack([rigid(rotation, rng.normal(size=3) * 100) for rotation in rotations])
    np.testing.assert_allclose(inverse(many), np.linalg.inv(many), atol=1e-12)
    np.testing.assert_allclose(inverse(many[0]), np.linalg.inv(many[0]), atol=1e-12)


def test_inverses_of_far_poses_lose_nothing():
    far = rigid(rotation_z(0.3), [5e6, 5e6, 0])
    near = rigid(rotation_z(0.4), [5e6 + 3, 5e6, 0])
    expected = rigid(rotation_z(0.1), rotation_z(-0.3) @ [3, 0, 0])
    np.testing.assert_allclose(inverse(far) @ near, expected, atol=2e-9)


def test_a_point_is_projected_through_the_pinhole():
    # 10 m ahead, 2 m to the left, 1 m up: u = 80 - 100 * 2 / 10, v = 32 - 50 * 1 / 10.
    pixels, depth_m = project(np.array([[10.0, 2, 1]]), image_T_ego(INTRINSICS, AHEAD))
    np.testing.assert_allclose(pixels, [[60, 27]])
    np.testing.assert_allclose(depth_m, [10])


def test_a_camera_that_stands_aside_sees_things_from_there():
    # 2 m to the left of the ego and 1.5 m up, looking left: x right is forward, z is y.
    looking_left = np.array([[1, 0, 0, 0], [0, 0, -1, 1.5], [0, 1, 0, -2], [0, 0, 0, 1.0]])
    pixels, depth_m = project(np.array([3.0, 7.0, 0.5]), image_T_ego(INTRINSICS, looking_left))
    np.testing.assert_allclose(pixels, [80 + 100 * 3 / 5, 32 + 50 * 1 / 5])
    np.testing.assert_allclose(depth_m, 5)


def test_points_behind_the_camera_have_negative_depth_and_finite_pixels():
    pixels, depth_m = project(np.array([[-5.0, 1, 1], [0, 1, 1]]), image_T_ego(INTRINSICS, AHEAD))
    np.testing.assert_allclose(depth_m, [-5, 0])
    assert np.isfinite(pixels).all()


def test_corners_go_round_from_front_left_at_the_bottom_and_then_at_the_top():
    # At (10, 0, 1): 2 m wide, 4 m long, 1 m high, looking along y: front is +y, left is -x.
    corners = box_corners(np.array([[10, 0, 1, 2, 4, 1, np.pi / 2, 0, 0]]))
    bottom = [(9, 2), (11, 2), (11, -2), (9, -2)]
    expected = [(x, y, 0.5) for x, y in bottom] + [(x, y, 1.5) for x, y in bottom]
    np.testing.assert_allclose(corners, [expected], atol=1e-14)


@pytest.mark.parametrize("boxes", [np.zeros((0, 9)), []])
def test_no_boxes_have_no_corners(boxes):
    assert box_corners(boxes).shape == (0, 8, 3)
