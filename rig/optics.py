"""Quantities derived from one camera's calibration: field of view, pose, rotation error and principal point."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera

Array = NDArray[np.float64]

EGO_UP = np.array([0.0, 0.0, 1.0])


class FieldOfView(NamedTuple):
    """Angles [deg] between the rays through opposite image borders, at their middles, and through opposite corners."""

    horizontal: float
    vertical: float
    diagonal: float


@dataclass(frozen=True)
class CameraPose:
    """Position and viewing direction of a camera in the ego frame. A broken matrix may give NaN.

    position_m: (3,).
    azimuth_deg: of the optical axis: 0 forward, positive to the left.
    elevation_deg: of the optical axis above the horizontal.
    roll_deg: about the optical axis: positive if the right side of the image is lower than the left side. NaN for a
        camera that looks straight up or down.
    """

    position_m: Array
    azimuth_deg: float
    elevation_deg: float
    roll_deg: float


def field_of_view(camera: Camera) -> FieldOfView:
    """The field of view between the rays through the image borders, which includes principal point offset and skew."""
    width, height = camera.width_px, camera.height_px
    middle_u, middle_v = width / 2, height / 2
    corners = np.array([(0, 0), (width, height), (width, 0), (0, height)], dtype=np.float64)
    falling, rising = angles_between_deg(camera, corners[0::2], corners[1::2])
    horizontal, vertical = angles_between_deg(
        camera, np.array([(0, middle_v), (middle_u, 0)]), np.array([(width, middle_v), (middle_u, height)])
    )
    return FieldOfView(float(horizontal), float(vertical), float(max(falling, rising)))


def angles_between_deg(camera: Camera, pixels: Array, other_pixels: Array) -> Array:
    """Angles (K,) [deg] between the rays through pixels (K, 2) and those through other pixels (K, 2)."""
    one, other = pixel_rays(camera, pixels), pixel_rays(camera, other_pixels)
    # arctan2 keeps its precision for small angles, where arccos of the scalar product loses it.
    with np.errstate(invalid="ignore"):
        return np.degrees(np.arctan2(np.linalg.norm(np.cross(one, other), axis=-1), (one * other).sum(axis=-1)))


def pixel_rays(camera: Camera, pixels: Array) -> Array:
    """Unit vectors (..., 3) in the camera frame through pixels (..., 2); NaN if the intrinsics have no inverse."""
    homogeneous = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
    directions = homogeneous @ _inverse(camera.intrinsics_px).T
    with np.errstate(all="ignore"):
        return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


def camera_pose(camera_T_ego: Array) -> CameraPose:
    """Position and viewing direction of a camera. Accepts any 4x4 matrix, also one that is not rigid."""
    rotation, ego_T_camera = camera_T_ego[:3, :3], _inverse(camera_T_ego)
    with np.errstate(all="ignore"):
        right, _, axis = rotation / np.linalg.norm(rotation, axis=1, keepdims=True)
        level_right = np.cross(axis, EGO_UP)
        level_down = np.cross(axis, level_right)
        is_vertical = np.linalg.norm(level_right) < 1e-6
        roll = np.nan if is_vertical else np.arctan2(right @ level_down, right @ level_right)
        elevation = np.arctan2(axis[2], np.hypot(axis[0], axis[1]))
        return CameraPose(
            ego_T_camera[:3, 3],
            float(np.degrees(np.arctan2(axis[1], axis[0]))),
            float(np.degrees(elevation)),
            float(np.degrees(roll)),
        )


def orthonormality_error(rotation: Array) -> float:
    """The largest absolute element of R Rᵀ - I."""
    with np.errstate(all="ignore"):
        return float(np.abs(rotation @ rotation.T - np.eye(3)).max())


def principal_point_fraction(camera: Camera) -> tuple[float, float]:
    """The principal point as a fraction of image width and height; (0.5, 0.5) is the centre."""
    return float(camera.intrinsics_px[0, 2] / camera.width_px), float(camera.intrinsics_px[1, 2] / camera.height_px)


def _inverse(matrix: Array) -> Array:
    """The inverse of a matrix, or NaN if it is singular."""
    try:
        with np.errstate(all="ignore"):
            return np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.full_like(matrix, np.nan)
