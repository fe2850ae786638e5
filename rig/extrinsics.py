"""Checks of one camera's extrinsics: its position on the vehicle and its viewing direction."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera
from .extrinsic_causes import DEGREES_AS_RADIANS, cause_of_odd_pose, likely_causes
from .extrinsic_mistakes import WRONG_QUATERNION_ORDER
from .findings import Finding, Verdict
from .formatting import describe_elevation, describe_position, describe_roll
from .optics import CameraPose
from .pose_plausibility import RigContext

Array = NDArray[np.float64]

LARGEST_DISTANCE_M = 20.0  # from the ego origin: road trains are at most about 18.75 m long
LOWEST_M, HIGHEST_M = 0.2, 5.0  # above the road: most vehicles are at most 4 m high, a mast may add a little
LARGEST_ELEVATION_DEG = 20.0  # cameras that observe the road look about level
SMALLEST_ELEVATION_DEG = -45.0  # parking cameras look down
LARGEST_ROLL_DEG = 30.0  # mounts are level to a few degrees
MAX_CAUSES = 2  # only the most likely causes are reported

CORRECT_EXTRINSICS = "Correct camera_T_ego. Compare the ground grid with the road in the camera's picture."


def extrinsics_findings(
    camera: Camera, pose: CameraPose, name: str = "", context: RigContext | None = None
) -> Iterator[Finding]:
    """Yield the findings about a valid extrinsic matrix.

    pose: from this matrix.
    name: the camera's name, which may say its direction.
    context: of the other cameras of the rig.
    """
    x, y, z = pose.position_m
    distance_m = float(np.hypot(x, y))
    is_impossible = z <= 0 or distance_m > LARGEST_DISTANCE_M or z > LARGEST_DISTANCE_M
    is_plausible_place = not is_impossible and LOWEST_M <= z <= HIGHEST_M
    is_level = SMALLEST_ELEVATION_DEG <= pose.elevation_deg <= LARGEST_ELEVATION_DEG
    # NaN, the roll of a camera that looks straight down, counts as upright.
    is_upright = not abs(pose.roll_deg) > LARGEST_ROLL_DEG
    if is_plausible_place and is_level and is_upright:
        if context is not None and (odd := cause_of_odd_pose(camera.camera_T_ego, name, context)):
            yield pose_finding(Verdict.SUSPECT, pose, likely_cause([odd]))
        return
    causes = likely_causes(camera.camera_T_ego, name, context)
    is_impossible = is_impossible or (bool(causes) and not is_upright and _is_too_low(pose, context))
    may_be_for_parking = is_plausible_place and is_upright and pose.elevation_deg < SMALLEST_ELEVATION_DEG
    yield pose_finding(
        Verdict.BROKEN if is_impossible else Verdict.SUSPECT,
        pose,
        _parking_cause(causes, context)
        if may_be_for_parking
        else _pose_cause(camera.camera_T_ego, causes, is_plausible_place),
    )


def _is_too_low(pose: CameraPose, context: RigContext | None) -> bool:
    """Whether a camera is too near the road, while the others are at usual heights, so that the ego origin is right."""
    has_right_origin = context is not None and context.height_m is not None and context.height_m > LOWEST_M
    return has_right_origin and bool(pose.position_m[2] < LOWEST_M)


def pose_finding(verdict: Verdict, pose: CameraPose, cause: str) -> Finding:
    """A finding about the pose of a camera."""
    return Finding(
        "pose",
        verdict,
        f"a camera {LOWEST_M:g} to {HIGHEST_M:g} m above the road (z = 0), at most {LARGEST_DISTANCE_M:g} m from the "
        "ego origin, about level and upright",
        f"{describe_position(pose.position_m)}, looking {describe_elevation(pose.elevation_deg)}"
        f"{describe_roll(pose.roll_deg)}",
        cause,
        CORRECT_EXTRINSICS,
    )


def likely_cause(causes: list[str]) -> str:
    """A sentence with the most likely causes."""
    return f"Likely cause: {'; or '.join(causes[:MAX_CAUSES])}."


def invalid_extrinsics_cause(camera_T_ego: Array) -> str:
    """The likely cause of an extrinsic matrix that `runtime/validation.py` rejects."""
    rotation = camera_T_ego[:3, :3]
    with np.errstate(all="ignore"):
        gram = rotation @ rotation.T
        scale = np.sqrt(np.trace(gram) / 3)
        is_scaled_rotation = bool(np.allclose(gram / scale**2, np.eye(3), atol=0.01))
    if np.any(camera_T_ego[3, :3] != 0) and not np.any(camera_T_ego[:3, 3]):
        return "The whole matrix is transposed: its translation is in the last row."
    if is_scaled_rotation and abs(scale - 1) > 1e-3:
        return f"The rotation is scaled by {scale:.4g}. A change of units must only scale the translation."
    if is_scaled_rotation and np.linalg.det(rotation) < 0:
        return "The rotation is mirrored: one axis has the wrong sign, or one of the frames is left-handed."
    if not np.array_equal(camera_T_ego[3], [0, 0, 0, 1]):
        return "The last row is not 0 0 0 1. The matrix may be a projection matrix."
    return "The 3x3 part is not a rotation: degrees used as radians, a quaternion not of length 1, or a typing error."


def _parking_cause(causes: list[str], context: RigContext | None) -> str:
    """The likely causes for a camera in a usual place that looks down.

    A wrong quaternion order explains nearly every such pose. It is only named if other cameras can be compared.
    """
    if context is None or context.height_m is None:
        causes = [cause for cause in causes if cause != WRONG_QUATERNION_ORDER]
    return f"{'; or '.join(['This may be a parking camera that looks down', *causes[: MAX_CAUSES - 1]])}."


def _pose_cause(camera_T_ego: Array, causes: list[str], is_plausible_place: bool) -> str:
    if not camera_T_ego[:3, 3].any():
        return "The translation is missing: all three values are 0."
    if causes:
        return likely_cause(causes)
    if camera_T_ego[:3, 3] @ camera_T_ego[:3, 2] >= 0:  # minus the height of the camera
        return "The camera is below the road. The ego frame may be on the roof or at a sensor instead of on the road."
    if is_plausible_place:
        return likely_cause([DEGREES_AS_RADIANS])
    return "No common mistake explains this. Several values may be wrong, or the camera is mounted like this."
