"""Validation of frames before the graphs run.

The graphs cannot detect bad numbers, and may turn them into plausible boxes. For example, onnxruntime's GridSample
returns finite values for a NaN grid.
"""

import numpy as np
from numpy.typing import NDArray

from .errors import InputError
from .frame import Camera, Frame

_ORTHONORMAL_TOLERANCE = 2e-3  # accepts rotations that were written with three decimals
_LARGEST = 1e9  # px or m: larger than any focal length and any coordinate on Earth
_LATEST_S = 1e11

# Limits as multiples of the image's width or height. A focal length below 0.1 means a field of view above 157
# degrees, which is not a pinhole camera; above 60 it is below 1 degree. Cropping can move the principal point out of
# the image, but not by more than the size of another image.
_SHORTEST_FOCAL, _LONGEST_FOCAL = 0.1, 60
_FARTHEST_CENTRE = 2


def check_frame(frame: Frame, num_cameras: int) -> None:
    """Check a whole frame: camera count, time, pose, calibrations and images.

    num_cameras: the largest number of cameras that the bundle accepts.
    Raises InputError, with the camera, what was expected, what was found, and what to do.
    """
    check_frame_header(frame, num_cameras)
    for name, camera in frame.cameras.items():
        check_camera(name, camera)
    for name in frame.images:
        if name not in frame.cameras:
            raise InputError(
                f"camera {name}: expected one of the calibrated cameras ({', '.join(frame.cameras)}); "
                "got an image of an unknown camera. Add its calibration, or leave the image out."
            )
    for name, camera in frame.cameras.items():
        _check_image(name, camera, frame)


def check_frame_header(frame: Frame, num_cameras: int) -> None:
    """Check the number of cameras, the time stamp and the ego pose of a frame. Raises InputError."""
    if not 1 <= len(frame.cameras) <= num_cameras:
        raise InputError(f"cameras: expected 1 to {num_cameras}, as the bundle was exported; got {len(frame.cameras)}.")
    _check_time("timestamp_s", frame.timestamp_s)
    _check_rigid("global_T_ego", frame.global_T_ego)


def check_camera(name: str, camera: Camera) -> None:
    """Check that a calibration is possible for a pinhole camera. Raises InputError.

    name: the camera's name, for the message.
    """
    size = (camera.width_px, camera.height_px)
    if not all(isinstance(pixels, (int, np.integer)) and pixels >= 1 for pixels in size):
        raise InputError(f"camera {name}: expected width_px and height_px of at least 1; got {size[0]!r}, {size[1]!r}.")
    intrinsics = _check_matrix(f"camera {name}: intrinsics_px", camera.intrinsics_px, (3, 3))
    upper = np.array_equal(np.tril(intrinsics, -1), [[0, 0, 0]] * 3) and intrinsics[2, 2] == 1
    if not upper or intrinsics[0, 0] <= 0 or intrinsics[1, 1] <= 0:
        raise InputError(
            f"camera {name}: intrinsics_px: expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with positive focal "
            f"lengths; got {intrinsics.tolist()}. Is the matrix transposed?"
        )
    _check_proportions(name, intrinsics, size)
    _check_rigid(f"camera {name}: camera_T_ego", camera.camera_T_ego)


def _check_proportions(name: str, intrinsics: NDArray, size_px: tuple[int, int]) -> None:
    for axis, row, pixels in (("x", 0, size_px[0]), ("y", 1, size_px[1])):
        focal, centre = intrinsics[row, row] / pixels, intrinsics[row, 2] / pixels
        if not _SHORTEST_FOCAL <= focal <= _LONGEST_FOCAL or abs(centre - 0.5) > _FARTHEST_CENTRE:
            raise InputError(
                f"camera {name}: intrinsics_px: expected a focal length f{axis} of {_SHORTEST_FOCAL} to "
                f"{_LONGEST_FOCAL} times the {pixels} px of the image, and a principal point c{axis} at most "
                f"{_FARTHEST_CENTRE} image sizes from its centre; got {intrinsics[row, row]:.6g} and "
                f"{intrinsics[row, 2]:.6g}. Are they in pixels of this image?"
            )


def _check_image(name: str, camera: Camera, frame: Frame) -> None:
    if name not in frame.images:
        raise InputError(f"camera {name}: expected an image, or None for a lost camera; got neither.")
    image = frame.images[name]
    if image is None:
        return
    expected = (camera.height_px, camera.width_px, 3)
    if not isinstance(image, np.ndarray) or image.dtype != np.uint8 or image.shape != expected:
        got = f"{image.dtype} {image.shape}" if isinstance(image, np.ndarray) else type(image).__name__
        raise InputError(
            f"camera {name}: expected an image of uint8 {expected} (height, width, BGR), as its calibration says; "
            f"got {got}."
        )


def _check_time(field: str, value: float) -> None:
    # In Python True is an int, and NaN fails every comparison, so both are refused here.
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not abs(value) <= _LATEST_S:
        raise InputError(f"{field}: expected seconds, at most {_LATEST_S:g}; got {repr(value)[:40]}.")


def _check_matrix(field: str, value: NDArray, shape: tuple[int, int]) -> NDArray:
    if not isinstance(value, np.ndarray) or value.shape != shape or value.dtype.kind not in "fiu":
        got = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        raise InputError(f"{field}: expected a {shape[0]}x{shape[1]} matrix of numbers; got {got}.")
    if not (np.abs(value.astype(np.float64)) <= _LARGEST).all():
        raise InputError(f"{field}: expected finite numbers, at most {_LARGEST:g}; got {value.tolist()}.")
    return value.astype(np.float64)


def _check_rigid(field: str, value: NDArray) -> None:
    a_T_b = _check_matrix(field, value, (4, 4))
    rotation = a_T_b[:3, :3]
    deviation = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if deviation > _ORTHONORMAL_TOLERANCE or np.linalg.det(rotation) < 0:
        raise InputError(
            f"{field}: expected a rotation (orthonormal to {_ORTHONORMAL_TOLERANCE}, determinant 1); got a matrix that "
            f"is off by {deviation:.3g}, determinant {np.linalg.det(rotation):.3g}. "
            "Is it scaled or mirrored, or from a quaternion that does not have length 1?"
        )
    if not np.array_equal(a_T_b[3], [0, 0, 0, 1]):
        raise InputError(f"{field}: expected the last row 0 0 0 1; got {a_T_b[3].tolist()}. Is the matrix transposed?")
