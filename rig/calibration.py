"""What can be wrong with one camera's calibration, by itself and against its picture.

What `runtime/validation.py` refuses is broken. Beyond that only what no camera on a vehicle can have is broken; the
rest is suspect, since there are rigs that are built so.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError
from ..runtime.frame import Camera
from ..runtime.validation import check_camera
from .extrinsic_mistakes import QUATERNION_ORDER, likely_causes
from .findings import Finding, Verdict, refusal, worst
from .formatting import describe_elevation, describe_roll
from .optics import Pose, pose, principal_point_share
from .recording import CameraImage

Array = NDArray[np.float64]

FARTHEST_M = 20.0  # from the ego's origin: road trains end at about 18.75 m
LOWEST_M, HIGHEST_M = 0.2, 5.0  # above the road: vehicles are at most 4 m high in most countries, masts a little more
STEEPEST_UP_DEG = 20.0  # a camera that is to see the road looks about level
STEEPEST_DOWN_DEG = 45.0  # those for parking look down
LARGEST_ROLL_DEG = 30.0  # mounts are level to a few degrees
WIDEST_DEG = 130.0  # wider lenses are fisheyes, which no pinhole describes
NARROWEST_DEG = 8.0  # narrower ones are telescopes
CENTRE_OFF_ACROSS, CENTRE_OFF_DOWN = 0.2, 0.35  # of the size: the sky is often cut off, the sides hardly ever
LARGEST_ASPECT = 1.1  # of fx and fy: pixels are square to a percent, and pictures squeezed by more look wrong
LARGEST_SKEW = 0.02  # of fx: a sensor's axes are square to far less than this, one degree
LEAST_RESIZED = 0.1  # principal points are nearer to the middle than this share, or off it in one direction only
MOST_CAUSES = 2  # that are told: the first are the simplest
SAME_RATIO = 0.12  # a principal point is within this share of where it should be, or of the same share down as across

LOOK = "Look at the ground grid in the camera's picture."
CORRECT_EXTRINSIC = f"Correct camera_T_ego. {LOOK}"
CORRECT_INTRINSICS = f"Give intrinsics_px, width_px and height_px of the picture as it lies in the file. {LOOK}"


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera's numbers, where it stands by them, and what is wrong with them by themselves."""

    name: str
    camera: Camera
    where: Pose
    findings: tuple[Finding, ...]

    @classmethod
    def of(cls, name: str, camera: Camera) -> "Calibration":
        """Look at the numbers of a camera."""
        where = pose(camera.camera_T_ego)
        return cls(name, camera, where, tuple(_findings(name, camera, where)))

    @property
    def is_sound(self) -> bool:
        """Whether the camera may be looked through."""
        return worst(self.findings) is not Verdict.BROKEN

    @property
    def has_direction(self) -> bool:
        """Whether its direction may be held against a name: only where nothing is wrong with the pose by itself."""
        return self.is_sound and all(finding.subject != "pose" for finding in self.findings)


def photo_findings(photo: CameraImage, camera: Camera) -> list[Finding]:
    """What is wrong with a camera's picture, or between it and the calibration."""
    if photo.error is None:
        return []
    return [refusal("picture", photo.error, _size_cause(photo.size_px, (camera.width_px, camera.height_px)))]


def _findings(name: str, camera: Camera, where: Pose) -> Iterator[Finding]:
    try:
        check_camera(name, camera)
    except InputError as error:
        yield _refused(camera, error)
        return
    yield from _lens_findings(camera)
    yield from _pose_findings(camera, where)


def _refused(camera: Camera, error: InputError) -> Finding:
    if ": camera_T_ego" in str(error):
        return refusal("camera_T_ego", error, _matrix_cause(camera.camera_T_ego), CORRECT_EXTRINSIC)
    return refusal("intrinsics_px", error, _intrinsics_cause(camera), CORRECT_INTRINSICS)


def _matrix_cause(camera_T_ego: Array) -> str:
    """Why a matrix is not rigid."""
    rotation = camera_T_ego[:3, :3]
    with np.errstate(all="ignore"):
        gram = rotation @ rotation.T
        scale = np.sqrt(np.trace(gram) / 3)
        is_scaled_rotation = bool(np.allclose(gram / scale**2, np.eye(3), atol=0.01))
    if np.any(camera_T_ego[3, :3] != 0) and not np.any(camera_T_ego[:3, 3]):
        return "The whole matrix is transposed: its translation stands in the last row."
    if is_scaled_rotation and abs(scale - 1) > 1e-3:
        return f"The rotation is scaled by {scale:.4g}: its unit was changed with that of the translation."
    if is_scaled_rotation and np.linalg.det(rotation) < 0:
        return "The rotation is mirrored: one axis has the wrong sign, or one of the frames is left-handed."
    if not np.array_equal(camera_T_ego[3], [0, 0, 0, 1]):
        return "The last row is not that of a rigid transform: is it a projection matrix?"
    return "No rotation is like this: degrees taken as radians, a quaternion not of length 1, or a typing error."


def _intrinsics_cause(camera: Camera) -> str:
    """Why a matrix is not that of a pinhole, or not of this picture."""
    intrinsics = camera.intrinsics_px
    if np.any(np.tril(intrinsics, -1)) and not np.any(np.triu(intrinsics, 1)):
        return "The matrix is transposed: its principal point stands in the last row."
    if intrinsics[0, 0] < 0 or intrinsics[1, 1] < 0:
        return "A focal length is negative: camera axes with x to the left, y up or z backward."
    if np.any(np.tril(intrinsics, -1)) or intrinsics[2, 2] != 1 or intrinsics[0, 0] * intrinsics[1, 1] == 0:
        return "It is not an upper triangular matrix with 1 in its corner: is it a projection, or a distortion?"
    if not NARROWEST_DEG <= max(_angles_deg(camera)) <= WIDEST_DEG:
        return _unit_cause(camera)
    return _centre_cause(camera)


def _lens_findings(camera: Camera) -> Iterator[Finding]:
    unit = _unit_finding(camera)
    if unit is not None:
        yield unit
        return
    (fx, skew, _), (_, fy, _), _ = camera.intrinsics_px
    across, down = principal_point_share(camera)
    is_off = abs(across - 0.5) > CENTRE_OFF_ACROSS or abs(down - 0.5) > CENTRE_OFF_DOWN
    if is_off or _resize_factor(camera) is not None:
        yield Finding(
            "principal point",
            Verdict.SUSPECT,
            "near the middle of the picture",
            f"{across:.2f} of its width and {down:.2f} of its height",
            _centre_cause(camera),
            CORRECT_INTRINSICS,
        )
    if not 1 / LARGEST_ASPECT <= fx / fy <= LARGEST_ASPECT:
        yield Finding(
            "focal lengths",
            Verdict.SUSPECT,
            "fx and fy about equal",
            f"fx / fy = {fx / fy:.3f}",
            "The picture was squeezed in one direction, or the intrinsics were scaled in one direction only.",
            CORRECT_INTRINSICS,
        )
    if abs(skew) > LARGEST_SKEW * fx:
        yield Finding(
            "skew",
            Verdict.SUSPECT,
            "about 0 in the first row's middle",
            f"{skew:.4g} px",
            "Pixels are not slanted: does another number stand in this place?",
            CORRECT_INTRINSICS,
        )


def _unit_finding(camera: Camera) -> Finding | None:
    """A lens that hardly any pinhole has, because the focal length is in another unit or of another picture."""
    (fx, _, _), (_, fy, _), _ = camera.intrinsics_px
    angles_deg = _angles_deg(camera)
    if NARROWEST_DEG <= max(angles_deg) <= WIDEST_DEG:
        return None
    return Finding(
        "focal length",
        Verdict.SUSPECT,
        f"one that lets the picture show {NARROWEST_DEG:g} to {WIDEST_DEG:g} degrees in its longer direction",
        f"fx = {fx:.5g} px, fy = {fy:.5g} px, for {angles_deg[0]:.1f} x {angles_deg[1]:.1f} degrees",
        _unit_cause(camera),
        CORRECT_INTRINSICS,
    )


def _angles_deg(camera: Camera) -> list[float]:
    """Across and down, as if the principal point were in the middle: where it really is, is a matter of its own."""
    halves = [camera.width_px / (2 * camera.intrinsics_px[0, 0]), camera.height_px / (2 * camera.intrinsics_px[1, 1])]
    return [float(2 * np.degrees(np.arctan(half))) for half in halves]


def _unit_cause(camera: Camera) -> str:
    fx, cx, cy = camera.intrinsics_px[0, 0], camera.intrinsics_px[0, 2], camera.intrinsics_px[1, 2]
    if max(_angles_deg(camera)) <= WIDEST_DEG:
        return "The lens is a telescope, or the intrinsics are those of a larger picture."
    if fx < 10 and 0 <= cx <= 1 and 0 <= cy <= 1:
        return "The intrinsics are normalised, fractions of the picture's size and not pixels."
    if fx < 100 and cx < 0.1 * camera.width_px:
        return "The intrinsics are in millimetres, not in pixels: divide them by the size of a pixel."
    return "The lens is a fisheye, to be rectified first, or the intrinsics are those of a smaller picture."


def _centre_cause(camera: Camera) -> str:
    width, height = camera.width_px, camera.height_px
    across, down = principal_point_share(camera)
    if abs(across * width / height - 0.5) < SAME_RATIO and abs(down * height / width - 0.5) < SAME_RATIO:
        return "Width and height are swapped, or the picture was turned after the calibration."
    factor = _resize_factor(camera)
    if factor is not None:
        size = f"about {round(factor * width)}x{round(factor * height)} px, {factor:.2f} times"
        return f"The intrinsics are of another resolution, {size} the {width}x{height} px of the calibration."
    return "The picture was cut and the principal point did not follow, or the intrinsics are of another resolution."


def _resize_factor(camera: Camera) -> float | None:
    """By how much the intrinsics' picture is larger than the calibration's, if it is: the principal point is then off
    the middle by that factor in both directions.
    """
    across, down = principal_point_share(camera)
    is_far = min(abs(2 * across - 1), abs(2 * down - 1)) > LEAST_RESIZED
    return across + down if is_far and down > 0 and abs(across / down - 1) < SAME_RATIO else None


def _pose_findings(camera: Camera, where: Pose) -> Iterator[Finding]:
    x, y, z = where.position_m
    distance_m = float(np.hypot(x, y))
    is_impossible = z <= 0 or distance_m > FARTHEST_M or z > FARTHEST_M
    is_odd_place = not LOWEST_M <= z <= HIGHEST_M
    is_upright = not abs(where.roll_deg) > LARGEST_ROLL_DEG  # or looks straight down, where there is no roll
    is_level = -STEEPEST_DOWN_DEG <= where.elevation_deg <= STEEPEST_UP_DEG
    if not (is_impossible or is_odd_place) and is_level and is_upright:
        return
    may_park = not (is_impossible or is_odd_place) and is_upright and where.elevation_deg < -STEEPEST_DOWN_DEG
    yield Finding(
        "pose",
        Verdict.BROKEN if is_impossible else Verdict.SUSPECT,
        f"a camera {LOWEST_M:g} to {HIGHEST_M:g} m above the road (z = 0), at most {FARTHEST_M:g} m from the ego's "
        "origin, about level and upright",
        f"x {x:.2f}, y {y:.2f}, z {z:.2f} m, looking {describe_elevation(where.elevation_deg)}"
        f"{describe_roll(where.roll_deg)}",
        _parking_cause(camera.camera_T_ego) if may_park else _pose_cause(camera.camera_T_ego, z),
        CORRECT_EXTRINSIC,
    )


def _parking_cause(camera_T_ego: Array) -> str:
    """Why a camera in a usual place looks down; a wrong quaternion would explain nearly any, and is not told."""
    causes = [cause for cause in likely_causes(camera_T_ego) if cause != QUATERNION_ORDER]
    return f"{', or '.join(['A camera for parking may be mounted so', *causes[: MOST_CAUSES - 1]])}."


def _pose_cause(camera_T_ego: Array, height_m: float) -> str:
    if not camera_T_ego[:3, 3].any():
        return "The translation is missing: all of it is 0."
    causes = likely_causes(camera_T_ego)
    if causes:
        return f"Likely {', or '.join(causes[:MOST_CAUSES])}."
    if height_m <= 0:
        return "The camera is below the road: the ego frame lies not on the road but on the roof or at a sensor."
    return "No usual mistake explains it: the camera may be mounted so, or several things are wrong at once."


def _size_cause(got: tuple[int, int] | None, expected: tuple[int, int]) -> str:
    """Why a picture has another size than its calibration says; nothing where that is not what is wrong."""
    if got is None or got == expected:
        return ""
    if got == expected[::-1]:
        return "Width and height are swapped, or the picture was turned after the calibration."
    ratio = got[0] / expected[0]
    if abs(got[1] / expected[1] / ratio - 1) < 0.02:
        return f"The picture was scaled by {ratio:.4g} after the calibration; the intrinsics must be scaled with it."
    return "The picture was cut after the calibration, or it is another camera's."
