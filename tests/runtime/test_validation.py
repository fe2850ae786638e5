"""The limits of valid frames: the last value that is accepted, and the first that is refused.

tests/reliability/test_frames.py has the kinds of invalid frames, and shows that they leave a stream unchanged.
"""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.runtime.errors import InputError
from duospacenet.runtime.frame import Camera, Frame
from duospacenet.runtime.geometry import CAMERA_R_BODY, rigid_transform
from duospacenet.runtime.validation import check_camera, check_frame, check_frame_header

WIDTH_PX, HEIGHT_PX = 200, 100
POSE = rigid_transform(np.eye(3), [0, 0, 0])


def camera(fx=100.0, fy=100.0, cx=100.0, cy=50.0, skew=0.0, camera_T_ego=None, size=(WIDTH_PX, HEIGHT_PX)):
    intrinsics = np.array([[fx, skew, cx], [0, fy, cy], [0, 0, 1.0]])
    pose = rigid_transform(CAMERA_R_BODY, [0, 1.5, 0]) if camera_T_ego is None else camera_T_ego
    return Camera(intrinsics, pose, *size)


def frame(num_cameras=2, **changes):
    cameras = {f"camera {number}": camera() for number in range(num_cameras)}
    return replace(Frame(dict.fromkeys(cameras), cameras, POSE, 10.0), **changes)


def is_accepted(check, *arguments):
    try:
        check(*arguments)
    except InputError:
        return False
    return True


@pytest.mark.parametrize(("num_cameras", "accepted"), [(0, False), (1, True), (3, True), (4, False)])
def test_a_frame_has_1_camera_to_the_number_of_the_bundle(num_cameras, accepted):
    assert is_accepted(check_frame, frame(num_cameras), 3) == accepted
    assert is_accepted(check_frame_header, frame(num_cameras), 3) == accepted


@pytest.mark.parametrize(
    ("intrinsics", "accepted"),
    [
        # Focal lengths of 0.1 to 60 times the size of the image, for each axis with its own size.
        ({"fx": 20.0}, True),
        ({"fx": 19.9}, False),
        ({"fx": 12_000.0}, True),
        ({"fx": 12_001.0}, False),
        ({"fy": 10.0}, True),
        ({"fy": 9.9}, False),
        ({"fy": 6_000.0}, True),
        ({"fy": 6_001.0}, False),
        ({"fx": -100.0}, False),
        ({"fy": -100.0}, False),
        ({"fx": 0.0}, False),
        # A principal point at most two image sizes from the centre, (100, 50).
        ({"cx": 500.0}, True),
        ({"cx": 501.0}, False),
        ({"cx": -300.0}, True),
        ({"cx": -301.0}, False),
        ({"cy": 250.0}, True),
        ({"cy": 251.0}, False),
        ({"cy": -150.0}, True),
        ({"cy": -151.0}, False),
        ({"skew": 3.0}, True),
    ],
)
def test_intrinsics_are_limited_by_the_size_of_the_image(intrinsics, accepted):
    assert is_accepted(check_camera, "front", camera(**intrinsics)) == accepted


@pytest.mark.parametrize(("row", "column"), [(1, 0), (2, 0), (2, 1), (2, 2)])
def test_intrinsics_are_an_upper_triangular_matrix_with_1_in_the_corner(row, column):
    changed = camera()
    changed.intrinsics_px[row, column] += 0.001
    with pytest.raises(InputError, match="Is the matrix transposed"):
        check_camera("front", changed)


@pytest.mark.parametrize(("size", "accepted"), [((1, 1), True), ((0, 1), False), ((1, 0), False), ((-1, 1), False)])
def test_an_image_has_at_least_one_pixel(size, accepted):
    assert is_accepted(check_camera, "front", camera(1, 1, 0.5, 0.5, size=size)) == accepted


@pytest.mark.parametrize(("stretch", "accepted"), [(1 + 0.9e-3, True), (1 - 0.9e-3, True), (1 + 1.1e-3, False)])
def test_a_rotation_is_orthonormal_to_2e_3(stretch, accepted):
    """A stretch by s changes R Rᵀ by about 2 (s - 1)."""
    pose = rigid_transform(np.eye(3) * stretch, [0, 0, 0])
    assert is_accepted(check_frame_header, frame(global_T_ego=pose), 2) == accepted
    assert is_accepted(check_camera, "front", camera(camera_T_ego=pose)) == accepted


@pytest.mark.parametrize("axis", range(3))
def test_a_mirrored_pose_is_refused(axis):
    mirrored = np.eye(4)
    mirrored[axis, axis] = -1
    with pytest.raises(InputError, match=r"global_T_ego: expected a rotation .*determinant -1"):
        check_frame_header(frame(global_T_ego=mirrored), 2)
    with pytest.raises(InputError, match=r"camera front: camera_T_ego: expected a rotation"):
        check_camera("front", camera(camera_T_ego=mirrored))


@pytest.mark.parametrize(("column", "value"), [(0, 1e-9), (1, -1e-9), (2, 1.0), (3, 1 + 1e-9)])
def test_the_last_row_of_a_pose_is_exactly_0_0_0_1(column, value):
    pose = POSE.copy()
    pose[3, column] = value
    with pytest.raises(InputError, match=r"expected the last row 0 0 0 1; got .*Is the matrix transposed"):
        check_frame_header(frame(global_T_ego=pose), 2)


@pytest.mark.parametrize(("position_m", "accepted"), [(1e9, True), (-1e9, True), (1.001e9, False), (-1.001e9, False)])
def test_a_position_is_at_most_1e9_m_from_the_origin(position_m, accepted):
    pose = rigid_transform(np.eye(3), [0, position_m, 0])
    assert is_accepted(check_frame_header, frame(global_T_ego=pose), 2) == accepted


@pytest.mark.parametrize(("position_m", "accepted"), [(131_071.0, True), (-131_071.0, True), (131_072.0, False)])
def test_a_float32_position_is_precise_to_1_cm(position_m, accepted):
    """From 2^17 m on, float32 numbers are 2^-6 m apart, which is 1.6 cm."""
    pose = rigid_transform(np.eye(3), [0, 0, position_m]).astype(np.float32)
    assert is_accepted(check_frame_header, frame(global_T_ego=pose), 2) == accepted
    assert is_accepted(check_frame_header, frame(global_T_ego=pose.astype(np.float64)), 2)


@pytest.mark.parametrize(("time_s", "accepted"), [(1e11, True), (-1e11, True), (1.001e11, False), (-1.001e11, False)])
def test_a_time_stamp_is_at_most_1e11_s(time_s, accepted):
    assert is_accepted(check_frame_header, frame(timestamp_s=time_s), 2) == accepted


@pytest.mark.parametrize(("time_s", "accepted"), [(16_383.0, True), (-16_383.0, True), (16_384.0, False)])
def test_a_float32_time_stamp_is_precise_to_1_ms(time_s, accepted):
    """From 2^14 s on, float32 numbers are 2^-9 s apart, which is 2 ms."""
    assert is_accepted(check_frame_header, frame(timestamp_s=np.float32(time_s)), 2) == accepted
    assert is_accepted(check_frame_header, frame(timestamp_s=time_s), 2)


def test_each_camera_has_an_image_or_none_and_each_image_a_camera():
    images = frame().images
    with pytest.raises(InputError, match="camera camera 1: expected an image, or None for a lost camera; got neither"):
        check_frame(frame(images={"camera 0": None}), 2)
    with pytest.raises(InputError, match="camera rear: expected one of the calibrated cameras"):
        check_frame(frame(images={**images, "rear": None}), 2)


@pytest.mark.parametrize(
    ("shape", "dtype", "accepted"),
    [
        ((HEIGHT_PX, WIDTH_PX, 3), np.uint8, True),
        ((WIDTH_PX, HEIGHT_PX, 3), np.uint8, False),
        ((HEIGHT_PX, WIDTH_PX, 4), np.uint8, False),
        ((HEIGHT_PX, WIDTH_PX), np.uint8, False),
        ((3, HEIGHT_PX, WIDTH_PX), np.uint8, False),
        ((HEIGHT_PX, WIDTH_PX, 3), np.int8, False),
        ((HEIGHT_PX, WIDTH_PX, 3), np.float32, False),
    ],
)
def test_the_second_image_is_checked_like_the_first(shape, dtype, accepted):
    for name in ("camera 0", "camera 1"):
        images = {**frame().images, name: np.zeros(shape, dtype)}
        assert is_accepted(check_frame, frame(images=images), 2) == accepted


def test_every_camera_is_checked():
    cameras = {**frame().cameras, "camera 1": camera(fx=1.0)}
    with pytest.raises(InputError, match="camera camera 1: intrinsics_px: expected a focal length fx"):
        check_frame(frame(cameras=cameras), 2)
