"""One camera's calibration in numbers that a person can judge: angles, heights, errors of a rotation."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera

Array = NDArray[np.float64]

UP = np.array([0.0, 0.0, 1.0])


class FieldOfView(NamedTuple):
    """Angles [deg] between the rays through opposite borders, across the middle of the picture, and of its corners."""

    horizontal: float
    vertical: float
    diagonal: float


@dataclass(frozen=True)
class Pose:
    """Where a camera stands and looks, in the ego frame. NaN is what a broken matrix does not tell.

    position_m: (3,). azimuth_deg: of the optical axis, 0 ahead, positive to the left; elevation_deg: above the
    horizontal. roll_deg: about that axis, positive where the picture's right side hangs; NaN where it looks straight up
    or down.
    """

    position_m: Array
    azimuth_deg: float
    elevation_deg: float
    roll_deg: float


def field_of_view(camera: Camera) -> FieldOfView:
    """What a picture shows, from the rays through its borders: off-centre principal points and skew are in them."""
    width, height = camera.width_px, camera.height_px
    middle_u, middle_v = width / 2, height / 2
    corners = np.array([(0, 0), (width, height), (width, 0), (0, height)], dtype=np.float64)
    falling, rising = angles_deg(camera, corners[0::2], corners[1::2])
    across = angles_deg(
        camera, np.array([(0, middle_v), (middle_u, 0)]), np.array([(width, middle_v), (middle_u, height)])
    )
    return FieldOfView(float(across[0]), float(across[1]), float(max(falling, rising)))


def angles_deg(camera: Camera, one_px: Array, other_px: Array) -> Array:
    """The angles (K,) between the rays through pixels (K, 2) and those through others."""
    one, other = rays(camera, one_px), rays(camera, other_px)
    with np.errstate(invalid="ignore"):
        return np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other), axis=-1), (one * other).sum(axis=-1)))


def rays(camera: Camera, pixels: Array) -> Array:
    """Directions (..., 3) in the camera's frame through pixels (..., 2), of length 1; NaN where there are none."""
    homogeneous = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
    directions = homogeneous @ _inverse(camera.intrinsics_px).T
    with np.errstate(all="ignore"):
        return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def pose(camera_T_ego: Array) -> Pose:
    """Where a camera of this extrinsic stands and looks. The matrix may be any; nothing is made rigid."""
    rotation, ego_T_camera = camera_T_ego[:3, :3], _inverse(camera_T_ego)
    with np.errstate(all="ignore"):
        right, _, axis = rotation / np.linalg.norm(rotation, axis=1, keepdims=True)
        level_right = np.cross(axis, UP)
        level_down = np.cross(axis, level_right)
        is_vertical = np.linalg.norm(level_right) < 1e-6
        roll = np.nan if is_vertical else np.arctan2(right @ level_down, right @ level_right)
        elevation = np.arctan2(axis[2], np.hypot(axis[0], axis[1]))
        return Pose(
            ego_T_camera[:3, 3],
            float(np.degrees(np.arctan2(axis[1], axis[0]))),
            float(np.degrees(elevation)),
            float(np.degrees(roll)),
        )


def orthonormality_error(rotation: Array) -> float:
    """The largest element by which R Rᵀ is off the identity."""
    with np.errstate(all="ignore"):
        return float(np.abs(rotation @ rotation.T - np.eye(3)).max())


def principal_point_share(camera: Camera) -> tuple[float, float]:
    """The principal point as fractions of the picture's width and height; (0.5, 0.5) is the middle."""
    return float(camera.intrinsics_px[0, 2] / camera.width_px), float(camera.intrinsics_px[1, 2] / camera.height_px)


def _inverse(matrix: Array) -> Array:
    """The inverse, or NaN where there is none."""
    try:
        with np.errstate(all="ignore"):
            return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)
