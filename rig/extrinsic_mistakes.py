"""What else an extrinsic could mean: the mistakes that people make, each undone, to see whether that makes sense."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..runtime.geometry import CAMERA_R_BODY, inverse, quaternion_from_rotation, rigid, rotation_from_quaternion
from .optics import Pose, pose

Array = NDArray[np.float64]

# A rig's camera as it is usually mounted. Narrower than what is let pass: a guess needs better grounds than a doubt.
USUAL_HEIGHT_M = (0.2, 4.0)
USUAL_DISTANCE_M = 12.0
USUAL_ELEVATION_DEG = 25.0
USUAL_ROLL_DEG = 10.0

QUATERNION_ORDER = "a quaternion was read in the wrong order, w x y z for x y z w or the other way round"
Y_AND_Z_TURNED = np.diag([1.0, -1.0, -1.0])


def likely_causes(camera_T_ego: Array) -> list[str]:
    """The mistakes after whose undoing the camera stands and looks as cameras usually do, the simplest first."""
    return list(dict.fromkeys(cause for cause, reading in readings(camera_T_ego) if is_usual(pose(reading))))


def readings(camera_T_ego: Array) -> Iterator[tuple[str, Array]]:
    """Every mistake in words, and what the right `camera_T_ego` is if it was made. Takes a rigid transform."""
    ego_T_camera = inverse(camera_T_ego)
    rotation, translation = camera_T_ego[:3, :3], camera_T_ego[:3, 3]
    position = ego_T_camera[:3, 3]
    yield "the matrix is ego_T_camera, the inverse of what is asked for", ego_T_camera
    yield "the rotation is transposed", rigid(rotation.T, translation)
    yield "the rotation is transposed", inverse(rigid(rotation, position))
    yield (
        "the translation is the camera's position in the ego frame, not -R @ position",
        inverse(rigid(rotation.T, translation)),
    )
    yield "the translation is in millimetres", rigid(rotation, translation / 1000)
    yield "the translation is in centimetres", rigid(rotation, translation / 100)
    yield (
        "the camera axes are x forward, y left, z up, not z forward, x right, y down",
        rigid(CAMERA_R_BODY, np.zeros(3)) @ camera_T_ego,
    )
    yield (
        "the camera axes are those of OpenGL, y up and z backward",
        rigid(Y_AND_Z_TURNED, np.zeros(3)) @ camera_T_ego,
    )
    yield (
        "the ego axes have y to the right and z down, not y to the left and z up",
        camera_T_ego @ rigid(Y_AND_Z_TURNED, np.zeros(3)),
    )
    for order in (3, 0, 1, 2), (1, 2, 3, 0):  # x y z w that were read as w x y z, and the other way round
        yield QUATERNION_ORDER, inverse(rigid(_reordered(rotation.T, order), position))


def is_usual(camera: Pose) -> bool:
    """Whether a camera stands and looks as on nearly every rig."""
    x, y, z = camera.position_m
    return (
        USUAL_HEIGHT_M[0] <= z <= USUAL_HEIGHT_M[1]
        and bool(np.hypot(x, y) <= USUAL_DISTANCE_M)
        and abs(camera.elevation_deg) <= USUAL_ELEVATION_DEG
        and abs(camera.roll_deg) <= USUAL_ROLL_DEG
    )


def _reordered(rotation: Array, order: tuple[int, int, int, int]) -> Array:
    """The rotation (3, 3) whose quaternion w-x-y-z has the numbers of this one's in another order."""
    return rotation_from_quaternion(quaternion_from_rotation(rotation)[list(order)])
