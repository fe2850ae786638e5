"""Checks of one camera's intrinsics: focal lengths, principal point and skew."""

from collections.abc import Iterator

import numpy as np

from ..runtime.frame import Camera
from .findings import Finding, Verdict
from .optics import principal_point_fraction

LARGEST_ANGLE_DEG = 130.0  # wider lenses are fisheyes, which the pinhole model does not describe
SMALLEST_ANGLE_DEG = 8.0  # narrower lenses are telephoto lenses
# Of the principal point, as fractions of the image size: the sky is often cropped, the sides rarely.
LARGEST_OFFSET_X, LARGEST_OFFSET_Y = 0.2, 0.35
LARGEST_ASPECT = 1.1  # of fx and fy: pixels are square to about 1 %, and a stretch above 10 % is visible in an image
LARGEST_SKEW = 0.02  # fraction of fx, or 1 degree: real sensors have much less skew
LEAST_RESIZED_OFFSET = 0.1  # a resize moves both coordinates of the principal point by more than this fraction
LEAST_EXCHANGED_OFFSET, EXCHANGED_FRACTION = 0.1, 0.2  # the same for cx and cy that are exchanged, and afterwards
SAME_FRACTION = 0.12  # tolerance within which principal point fractions, or their ratio, count as equal

CORRECT_INTRINSICS = (
    "Give intrinsics_px, width_px and height_px of the image as it is stored. "
    "Compare the ground grid with the road in the camera's picture."
)


def intrinsics_findings(camera: Camera) -> Iterator[Finding]:
    """Yield the findings about valid intrinsics. With a wrong focal length, only that is reported."""
    focal_length = _focal_length_finding(camera)
    if focal_length is not None:
        yield focal_length
        return
    (fx, skew, _), (_, fy, _), _ = camera.intrinsics_px
    x, y = principal_point_fraction(camera)
    is_off_centre = abs(x - 0.5) > LARGEST_OFFSET_X or abs(y - 0.5) > LARGEST_OFFSET_Y
    if is_off_centre or _is_exchanged(camera) or _resize_factor(camera) is not None:
        yield Finding(
            "principal point",
            Verdict.SUSPECT,
            "a point near the image centre",
            f"{x:.2f} of the width and {y:.2f} of the height",
            _principal_point_cause(camera),
            CORRECT_INTRINSICS,
        )
    if not 1 / LARGEST_ASPECT <= fx / fy <= LARGEST_ASPECT:
        yield Finding(
            "focal lengths",
            Verdict.SUSPECT,
            "fx and fy about equal",
            f"fx / fy = {fx / fy:.3f}",
            "The image was stretched in one direction, or the intrinsics were scaled in one direction only.",
            CORRECT_INTRINSICS,
        )
    if abs(skew) > LARGEST_SKEW * fx:
        yield Finding(
            "skew",
            Verdict.SUSPECT,
            "about 0 px in row 1, column 2",
            f"{skew:.4g} px",
            "Camera pixels are not skewed. Another value may have been written to this element.",
            CORRECT_INTRINSICS,
        )


def invalid_intrinsics_cause(camera: Camera) -> str:
    """The likely cause of intrinsics that `runtime/validation.py` rejects."""
    intrinsics = camera.intrinsics_px
    if np.any(np.tril(intrinsics, -1)) and not np.any(np.triu(intrinsics, 1)):
        return "The matrix is transposed: its principal point is in the last row."
    if intrinsics[0, 0] < 0 or intrinsics[1, 1] < 0:
        return "A focal length is negative: the camera axes have x to the left, y up or z backward."
    if np.any(np.tril(intrinsics, -1)) or intrinsics[2, 2] != 1 or intrinsics[0, 0] * intrinsics[1, 1] == 0:
        return (
            "The matrix is not upper triangular with 1 as its last element. "
            "It may be a projection matrix, or contain distortion coefficients."
        )
    if not SMALLEST_ANGLE_DEG <= max(_centred_angles_deg(camera)) <= LARGEST_ANGLE_DEG:
        return _focal_length_cause(camera)
    return _principal_point_cause(camera)


def _focal_length_finding(camera: Camera) -> Finding | None:
    """A finding if the focal length does not fit a pinhole camera with an image of this size."""
    (fx, _, _), (_, fy, _), _ = camera.intrinsics_px
    angles_deg = _centred_angles_deg(camera)
    if SMALLEST_ANGLE_DEG <= max(angles_deg) <= LARGEST_ANGLE_DEG:
        return None
    return Finding(
        "focal length",
        Verdict.SUSPECT,
        f"a field of view of {SMALLEST_ANGLE_DEG:g} to {LARGEST_ANGLE_DEG:g} degrees in the longer direction",
        f"{angles_deg[0]:.1f} x {angles_deg[1]:.1f} degrees from fx = {fx:.5g} px, fy = {fy:.5g} px",
        _focal_length_cause(camera),
        CORRECT_INTRINSICS,
    )


def _centred_angles_deg(camera: Camera) -> list[float]:
    """Horizontal and vertical field of view [deg] if the principal point were centred. It is checked separately."""
    halves = [camera.width_px / (2 * camera.intrinsics_px[0, 0]), camera.height_px / (2 * camera.intrinsics_px[1, 1])]
    return [float(2 * np.degrees(np.arctan(half))) for half in halves]


def _focal_length_cause(camera: Camera) -> str:
    fx, cx, cy = camera.intrinsics_px[0, 0], camera.intrinsics_px[0, 2], camera.intrinsics_px[1, 2]
    is_narrow = max(_centred_angles_deg(camera)) <= LARGEST_ANGLE_DEG
    if not is_narrow and fx < 10 and 0 <= cx <= 1 and 0 <= cy <= 1:
        return "The intrinsics are normalised: they are fractions of the image size instead of pixels."
    if not is_narrow and fx < 100 and cx < 0.1 * camera.width_px:
        return "The intrinsics are in millimetres instead of pixels: divide them by the size of a pixel."
    factor = _resize_factor(camera)
    if factor is not None:
        return _resized_cause(camera, factor)
    if is_narrow:
        return "The camera has a telephoto lens, or the intrinsics belong to a larger image."
    return "The camera has a fisheye lens and needs rectification, or the intrinsics belong to a smaller image."


def _principal_point_cause(camera: Camera) -> str:
    width, height = camera.width_px, camera.height_px
    if _is_exchanged(camera):
        if width > height:
            return "Likely cause: cx and cy are exchanged. Or width and height are, or the image was rotated."
        return "Likely cause: width and height are swapped, or the image was rotated after the calibration."
    factor = _resize_factor(camera)
    if factor is not None:
        return _resized_cause(camera, factor)
    return "The image was cropped without moving the principal point, or the intrinsics belong to another resolution."


def _resized_cause(camera: Camera, factor: float) -> str:
    width, height = camera.width_px, camera.height_px
    size = f"about {round(factor * width)}x{round(factor * height)} px, {factor:.2f} times"
    return f"The intrinsics belong to another resolution, {size} the {width}x{height} px of the calibration."


def _is_exchanged(camera: Camera) -> bool:
    """Whether cx and cy are near the image centre only if they are exchanged."""
    x, y = principal_point_fraction(camera)
    aspect = camera.width_px / camera.height_px
    is_off_centre = min(abs(x - 0.5), abs(y - 0.5)) > LEAST_EXCHANGED_OFFSET
    is_centred_if_exchanged = max(abs(x * aspect - 0.5), abs(y / aspect - 0.5)) < EXCHANGED_FRACTION
    return is_off_centre and is_centred_if_exchanged


def _resize_factor(camera: Camera) -> float | None:
    """The factor from the calibration's image size to that of its intrinsics; None if they agree.

    With intrinsics of an image f times as large, both fractions of the principal point are about f / 2.
    """
    x, y = principal_point_fraction(camera)
    is_off_centre = min(abs(2 * x - 1), abs(2 * y - 1)) > LEAST_RESIZED_OFFSET
    return x + y if is_off_centre and y > 0 and abs(x / y - 1) < SAME_FRACTION else None
