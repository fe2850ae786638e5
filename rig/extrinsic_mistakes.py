"""Common mistakes in extrinsics, each with the correction that undoes it."""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.geometry import (
    CAMERA_R_BODY,
    inverse,
    quaternion_from_rotation,
    rigid_transform,
    rotation_from_quaternion,
    rotation_z,
)

Array = NDArray[np.float64]

WRONG_QUATERNION_ORDER = "the quaternion was read in the wrong order, w x y z instead of x y z w or the reverse"
RADIANS_AS_DEGREES = "angles in radians were read as degrees"
INVERTED = "the matrix is ego_T_camera, the inverse of camera_T_ego"
FLIPPED_Y_AND_Z = np.diag([1.0, -1.0, -1.0])
# By unit: metres per unit. Feet are left out: the height of a camera in feet is plausible in metres.
METRES_PER_UNIT = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "kilometres": 1000.0}
LARGEST_MISREAD_DEG = 5.5  # the rotation by three angles of up to pi, read as degrees, is at most pi * sqrt(3) degrees


class Mistake(NamedTuple):
    """A mistake in `camera_T_ego`.

    cause: as text, to follow "Likely cause: ".
    undo: returns the `camera_T_ego` (4, 4) without the mistake, or None if the given matrix cannot have it.
    doubt: how much better than others the correction must be. The mistakes that fit many matrices by chance have more.
    is_shared: whether only all cameras of a rig together can have the mistake.
    """

    cause: str
    undo: Callable[[Array], Array | None]
    doubt: float = 0.0
    is_shared: bool = False


def extrinsic_mistakes() -> Iterator[Mistake]:
    """Yield all mistakes, the simplest first. Several may have the same cause."""
    yield Mistake(INVERTED, inverse)
    yield Mistake("the rotation is transposed", lambda m: rigid_transform(m[:3, :3].T, m[:3, 3]), 0.5)
    yield Mistake("the rotation is transposed", lambda m: inverse(rigid_transform(m[:3, :3], inverse(m)[:3, 3])), 0.5)
    yield Mistake(
        "the translation is the camera's position in the ego frame, not -R @ position",
        lambda m: inverse(rigid_transform(m[:3, :3].T, m[:3, 3])),
    )
    for unit, metres in METRES_PER_UNIT.items():
        yield Mistake(f"the translation is in {unit}", _scale_translation(metres))
    yield Mistake(
        "the camera axes are x forward, y left, z up instead of x right, y down, z forward",
        lambda m: rigid_transform(CAMERA_R_BODY, np.zeros(3)) @ m,
    )
    yield Mistake(
        "the camera axes are those of OpenGL, with y up and z backward",
        lambda m: rigid_transform(FLIPPED_Y_AND_Z, np.zeros(3)) @ m,
    )
    yield Mistake(
        "the ego axes have y to the right and z down instead of y to the left and z up",
        lambda m: m @ rigid_transform(FLIPPED_Y_AND_Z, np.zeros(3)),
    )
    yield Mistake(
        "the ego axes are x right, y forward instead of x forward, y left", _turn_ego(90.0), 1.0, is_shared=True
    )
    yield Mistake(
        "the ego axes are x left, y backward instead of x forward, y left", _turn_ego(-90.0), 1.0, is_shared=True
    )
    yield Mistake("the ego x axis points backward", _turn_ego(180.0), 1.0, is_shared=True)
    for order in (3, 0, 1, 2), (1, 2, 3, 0):  # x y z w was read as w x y z, and the reverse
        yield Mistake(WRONG_QUATERNION_ORDER, _reorder_quaternion(order), 1.0)
    for of_camera in (False, True):
        yield Mistake(RADIANS_AS_DEGREES, _undo_misread_angles(of_camera), 0.5)
    yield Mistake(f"{RADIANS_AS_DEGREES} in the yaw", _undo_misread_yaw, 1.0)


def _scale_translation(factor: float) -> Callable[[Array], Array]:
    return lambda camera_T_ego: rigid_transform(camera_T_ego[:3, :3], camera_T_ego[:3, 3] * factor)


def _turn_ego(yaw_deg: float) -> Callable[[Array], Array]:
    return lambda camera_T_ego: camera_T_ego @ rigid_transform(rotation_z(np.radians(yaw_deg)), np.zeros(3))


def _reorder_quaternion(order: tuple[int, int, int, int]) -> Callable[[Array], Array]:
    """A correction that reorders the numbers of the quaternion (w x y z) of `ego_T_camera` and keeps its position."""

    def undo(camera_T_ego: Array) -> Array:
        quaternion = quaternion_from_rotation(camera_T_ego[:3, :3].T)[list(order)]
        return inverse(rigid_transform(rotation_from_quaternion(quaternion), inverse(camera_T_ego)[:3, 3]))

    return undo


def _undo_misread_angles(of_camera: bool) -> Callable[[Array], Array | None]:
    """A correction for all three Euler angles. of_camera: they are those of `camera_T_ego`, not of `ego_T_camera`."""

    def undo(camera_T_ego: Array) -> Array | None:
        position = inverse(camera_T_ego)[:3, 3]
        rotation = camera_T_ego[:3, :3] if of_camera else camera_T_ego[:3, :3].T
        angles = _euler_angles(rotation)
        if np.linalg.norm(np.degrees(angles)) > LARGEST_MISREAD_DEG:
            return None
        corrected = _rotation_from_euler(np.degrees(angles))
        return inverse(rigid_transform(corrected.T if of_camera else corrected, position))

    return undo


def _undo_misread_yaw(camera_T_ego: Array) -> Array | None:
    """A correction for the azimuth alone: it is within pi degrees of the x axis, and is multiplied by 180 / pi."""
    ego_T_camera = inverse(camera_T_ego)
    azimuth = np.arctan2(camera_T_ego[2, 1], camera_T_ego[2, 0])
    if abs(np.degrees(azimuth)) > np.pi:
        return None
    rotation = rotation_z(np.degrees(azimuth) - azimuth) @ ego_T_camera[:3, :3]
    return inverse(rigid_transform(rotation, ego_T_camera[:3, 3]))


def _euler_angles(rotation: Array) -> Array:
    """The angles (3,) [rad] about x, y and z of a rotation (3, 3) = Rz Ry Rx."""
    return np.array(
        [
            np.arctan2(rotation[2, 1], rotation[2, 2]),
            -np.arcsin(np.clip(rotation[2, 0], -1, 1)),
            np.arctan2(rotation[1, 0], rotation[0, 0]),
        ]
    )


def _rotation_from_euler(angles_rad: Array) -> Array:
    """The rotation (3, 3) Rz Ry Rx of angles (3,) about x, y and z."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(angles_rad), np.sin(angles_rad)
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return about_z @ about_y @ about_x
