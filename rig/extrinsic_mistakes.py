"""Common mistakes in extrinsics. A mistake explains an implausible pose if undoing it gives a typical pose."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..runtime.geometry import (
    CAMERA_R_BODY,
    inverse,
    quaternion_from_rotation,
    rigid_transform,
    rotation_from_quaternion,
)
from .optics import CameraPose, camera_pose

Array = NDArray[np.float64]

# Poses of cameras in most rigs. These limits are narrower than those of the checks in `extrinsics`, because a likely
# cause needs more evidence than a suspicion.
TYPICAL_HEIGHT_M = (0.2, 4.0)
TYPICAL_DISTANCE_M = 12.0
TYPICAL_ELEVATION_DEG = 25.0
TYPICAL_ROLL_DEG = 10.0

WRONG_QUATERNION_ORDER = "the quaternion was read in the wrong order, w x y z instead of x y z w or the reverse"
FLIPPED_Y_AND_Z = np.diag([1.0, -1.0, -1.0])


def likely_causes(camera_T_ego: Array) -> list[str]:
    """The mistakes that explain an extrinsic matrix, the simplest first.

    A mistake explains the matrix if undoing it gives a typical camera pose.
    camera_T_ego: (4, 4), a rigid transform.
    """
    causes = (cause for cause, corrected in undo_mistakes(camera_T_ego) if is_typical(camera_pose(corrected)))
    return list(dict.fromkeys(causes))


def undo_mistakes(camera_T_ego: Array) -> Iterator[tuple[str, Array]]:
    """Yield each mistake as text, with the `camera_T_ego` (4, 4) that results from undoing it.

    camera_T_ego: (4, 4), a rigid transform.
    """
    ego_T_camera = inverse(camera_T_ego)
    rotation, translation = camera_T_ego[:3, :3], camera_T_ego[:3, 3]
    position = ego_T_camera[:3, 3]
    yield "the matrix is ego_T_camera, the inverse of camera_T_ego", ego_T_camera
    yield "the rotation is transposed", rigid_transform(rotation.T, translation)
    yield "the rotation is transposed", inverse(rigid_transform(rotation, position))
    yield (
        "the translation is the camera's position in the ego frame, not -R @ position",
        inverse(rigid_transform(rotation.T, translation)),
    )
    yield "the translation is in millimetres", rigid_transform(rotation, translation / 1000)
    yield "the translation is in centimetres", rigid_transform(rotation, translation / 100)
    yield (
        "the camera axes are x forward, y left, z up instead of x right, y down, z forward",
        rigid_transform(CAMERA_R_BODY, np.zeros(3)) @ camera_T_ego,
    )
    yield (
        "the camera axes are those of OpenGL, with y up and z backward",
        rigid_transform(FLIPPED_Y_AND_Z, np.zeros(3)) @ camera_T_ego,
    )
    yield (
        "the ego axes have y to the right and z down instead of y to the left and z up",
        camera_T_ego @ rigid_transform(FLIPPED_Y_AND_Z, np.zeros(3)),
    )
    for order in (3, 0, 1, 2), (1, 2, 3, 0):  # x y z w was read as w x y z, and the reverse
        yield WRONG_QUATERNION_ORDER, inverse(rigid_transform(_with_quaternion_order(rotation.T, order), position))


def is_typical(pose: CameraPose) -> bool:
    """Whether a camera pose is typical for vehicle rigs."""
    x, y, z = pose.position_m
    return (
        TYPICAL_HEIGHT_M[0] <= z <= TYPICAL_HEIGHT_M[1]
        and bool(np.hypot(x, y) <= TYPICAL_DISTANCE_M)
        and abs(pose.elevation_deg) <= TYPICAL_ELEVATION_DEG
        and abs(pose.roll_deg) <= TYPICAL_ROLL_DEG
    )


def _with_quaternion_order(rotation: Array, order: tuple[int, int, int, int]) -> Array:
    """The rotation (3, 3) after reordering the numbers of its quaternion (w x y z)."""
    return rotation_from_quaternion(quaternion_from_rotation(rotation)[list(order)])
