"""Validation of frames before the graphs run.

The graphs cannot detect bad numbers, and may turn them into plausible boxes. For example, onnxruntime's GridSample
returns finite values for a NaN grid.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .calibration_limits import (
    FARTHEST_CENTRE,
    LARGEST,
    LATEST_S,
    LONGEST_FOCAL,
    ORTHONORMAL_TOLERANCE,
    SHORTEST_FOCAL,
)
from .errors import InputError
from .frame import Camera, Frame
from .printable import has_control_character, shortened

_TIME_PRECISION_S = 1e-3
_POSITION_PRECISION_M = 1e-2


def check_frame(frame: Frame, num_cameras: int) -> None:
    """Check a whole frame: names, camera count, time, pose, calibrations and images.

    num_cameras: the largest number of cameras that the bundle accepts.
    Raises InputError, with the camera, what was expected, what was found, and what to do.
    """
    _check_names(frame)
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
    _check_precision("global_T_ego", frame.global_T_ego)


def check_camera(name: str, camera: Camera) -> None:
    """Check that a calibration is possible for a pinhole camera. Raises InputError.

    name: the camera's name, for the message.
    """
    size = (camera.width_px, camera.height_px)
    if not all(_is_integer(pixels) and pixels >= 1 for pixels in size):
        raise InputError(
            f"camera {name}: expected width_px and height_px as integers of at least 1; got {shortened(size[0])}, "
            f"{shortened(size[1])}."
        )
    intrinsics = _check_matrix(f"camera {name}: intrinsics_px", camera.intrinsics_px, (3, 3))
    upper = np.array_equal(np.tril(intrinsics, -1), [[0, 0, 0]] * 3) and intrinsics[2, 2] == 1
    if not upper or intrinsics[0, 0] <= 0 or intrinsics[1, 1] <= 0:
        raise InputError(
            f"camera {name}: intrinsics_px: expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with positive focal "
            f"lengths; got {intrinsics.tolist()}. Is the matrix transposed?"
        )
    _check_proportions(name, intrinsics, size)
    _check_rigid(f"camera {name}: camera_T_ego", camera.camera_T_ego)


def _check_names(frame: Frame) -> None:
    """Check the names in a frame: OpenCV crashes on a lone surrogate, and a terminal obeys control characters."""
    for field, value in (("cameras", frame.cameras), ("images", frame.images)):
        if not isinstance(value, Mapping):
            raise InputError(f"{field}: expected a mapping from camera names; got {_describe(value)}.")
    cameras = (
        (f"{field}: name of a camera", name) for field in ("cameras", "images") for name in getattr(frame, field)
    )
    for field, name in (("scene", frame.scene), ("token", frame.token), *cameras):
        if not isinstance(name, str) or has_control_character(name):
            raise InputError(f"{field}: expected text without control characters; got {shortened(name)}. Rename it.")


def _check_proportions(name: str, intrinsics: NDArray, size_px: tuple[int, int]) -> None:
    for axis, row, pixels in (("x", 0, size_px[0]), ("y", 1, size_px[1])):
        focal, centre = intrinsics[row, row] / pixels, intrinsics[row, 2] / pixels
        if not SHORTEST_FOCAL <= focal <= LONGEST_FOCAL or abs(centre - 0.5) > FARTHEST_CENTRE:
            raise InputError(
                f"camera {name}: intrinsics_px: expected a focal length f{axis} of {SHORTEST_FOCAL} to "
                f"{LONGEST_FOCAL} times the {pixels} px of the image, and a principal point c{axis} at most "
                f"{FARTHEST_CENTRE} image sizes from its centre; got {intrinsics[row, row]:.6g} and "
                f"{intrinsics[row, 2]:.6g}. Are they in pixels of this image?"
            )


def _check_image(name: str, camera: Camera, frame: Frame) -> None:
    if name not in frame.images:
        raise InputError(f"camera {name}: expected an image, or None for a lost camera; got neither.")
    image = frame.images[name]
    if image is None:
        return
    expected = (camera.height_px, camera.width_px, 3)
    if not _is_array(image) or image.dtype != np.uint8 or image.shape != expected:
        raise InputError(
            f"camera {name}: expected an image of uint8 {expected} (height, width, BGR), as its calibration says; "
            f"got {_describe(image)}."
        )


def _check_time(field: str, value: float) -> None:
    # NaN fails every comparison, so it is refused here.
    is_float = isinstance(value, (float, np.floating)) and not isinstance(value, np.float16)
    if not (is_float or _is_integer(value)):
        raise InputError(f"{field}: expected seconds as a float or an integer; got {shortened(value)}.")
    if not abs(value) <= LATEST_S:
        raise InputError(
            f"{field}: expected seconds, at most {LATEST_S:g}; got {shortened(value)}. "
            "If the times are in milliseconds or microseconds, convert them."
        )
    # A Unix time as float32 is rounded to 128 s, and two frames would have the same time.
    if isinstance(value, np.floating) and (spacing_s := float(np.spacing(abs(value)))) > _TIME_PRECISION_S:
        raise InputError(
            f"{field}: expected seconds with a precision of 1 ms; got {value!r}, whose precision is {spacing_s:g} s. "
            "Use float64."
        )


def _check_matrix(field: str, value: NDArray, shape: tuple[int, int]) -> NDArray:
    if not _is_array(value) or value.shape != shape or not _is_number_type(value.dtype):
        raise InputError(
            f"{field}: expected a {shape[0]}x{shape[1]} matrix of float64, float32 or integers; got {_describe(value)}."
        )
    if not (np.abs(value.astype(np.float64)) <= LARGEST).all():
        raise InputError(f"{field}: expected finite numbers, at most {LARGEST:g}; got {value.tolist()}.")
    return value.astype(np.float64)


def _check_rigid(field: str, value: NDArray) -> None:
    a_T_b = _check_matrix(field, value, (4, 4))
    rotation = a_T_b[:3, :3]
    deviation = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if deviation > ORTHONORMAL_TOLERANCE or np.linalg.det(rotation) < 0:
        raise InputError(
            f"{field}: expected a rotation (orthonormal to {ORTHONORMAL_TOLERANCE}, determinant 1); got a matrix that "
            f"is off by {deviation:.3g}, determinant {np.linalg.det(rotation):.3g}. "
            "Is it scaled or mirrored, or from a quaternion that does not have length 1?"
        )
    if not np.array_equal(a_T_b[3], [0, 0, 0, 1]):
        raise InputError(f"{field}: expected the last row 0 0 0 1; got {a_T_b[3].tolist()}. Is the matrix transposed?")


def _check_precision(field: str, a_T_b: NDArray) -> None:
    """Check that a position far from the origin has not lost its digits in float32."""
    position = a_T_b[:3, 3]
    spacing_m = float(np.spacing(np.abs(position)).max()) if position.dtype.kind == "f" else 0.0
    if spacing_m > _POSITION_PRECISION_M:
        raise InputError(
            f"{field}: expected a position with a precision of 1 cm; got {position.dtype} {position.tolist()} m, whose "
            f"precision is {spacing_m:g} m. Use float64."
        )


def _is_integer(value: Any) -> bool:
    # In Python True is an int, and in NumPy a time difference is an integer.
    return isinstance(value, (int, np.integer)) and not isinstance(value, (bool, np.timedelta64))


def _is_array(value: Any) -> bool:
    # A masked array can have any value where it is masked. np.matrix multiplies in another way than an array.
    return isinstance(value, np.ndarray) and not isinstance(value, (np.ma.MaskedArray, np.matrix))


def _is_number_type(dtype: np.dtype) -> bool:
    # float16 has three decimal digits. Wider floats than float64 are not supported by linear algebra.
    return dtype.kind in "iu" or (dtype.kind == "f" and dtype.itemsize in (4, 8))


def _describe(value: Any) -> str:
    """The type of a value, and the dtype and shape of an array."""
    kind = type(value).__name__
    if not isinstance(value, np.ndarray):
        return kind if type(value).__module__ == "builtins" else f"{type(value).__module__}.{kind}"
    return f"{value.dtype} {value.shape}" if _is_array(value) else f"a {kind} of {value.dtype} {value.shape}"
