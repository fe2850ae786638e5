"""Coverage of a rig: the voxels and ground cells that its cameras see."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.bundle.manifest import PerceptionRange
from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.frame import Camera
from ..runtime.geometry import NEAREST_DEPTH_M, image_T_ego, project
from ..runtime.preprocessing import resize_transform
from .optics import camera_pose, pixel_rays

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GROUND_M = 0.0  # height of the road in the ego frame
BORDER_POINTS = 201  # along each side of an image


@dataclass(frozen=True)
class Coverage:
    """The voxels and ground cells that each camera sees.

    voxels: by camera, a mask (X, Y, Z) of the voxels with a visible centre.
    ground: by camera, a mask (X, Y) of the visible cells at the height of the road.
    Cell [i, j] is at x_i (forward) and y_j (left).
    """

    voxels: Mapping[str, Mask]
    ground: Mapping[str, Mask]

    def voxel_share(self, name: str) -> float:
        """The share of the voxels that a camera sees."""
        return float(self.voxels[name].mean())

    def ground_share(self, name: str) -> float:
        """The share of the ground cells that a camera sees."""
        return float(self.ground[name].mean())

    def exclusive_share(self, name: str) -> float:
        """The share of the voxels that only this camera sees."""
        return float((self.voxels[name] & (_count(self.voxels) == 1)).mean())

    def overlap(self, one: str, other: str) -> float:
        """The intersection over union of the voxels of two cameras; 0 if neither sees a voxel."""
        union = (self.voxels[one] | self.voxels[other]).sum()
        return float((self.voxels[one] & self.voxels[other]).sum() / union) if union else 0.0

    def shares_by_count(self) -> dict[str, float]:
        """The shares of the voxels that 0, 1, 2, and 3 or more cameras see."""
        count = _count(self.voxels)
        shares = {str(number): float((count == number).mean()) for number in range(3)}
        return shares | {"3+": float((count >= 3).mean())}

    def ground_count(self) -> NDArray[np.int64]:
        """The number of cameras that see each ground cell, (X, Y)."""
        return _count(self.ground)


def compute_coverage(
    cameras: Mapping[str, Camera], perception: PerceptionRange, preprocessing: Preprocessing | None
) -> Coverage:
    """Project all voxel centres and ground cells into all cameras.

    cameras: by name, with usable calibrations.
    preprocessing: parts of an image that it crops do not count as visible; None for whole images.
    """
    x, y, z = voxel_centres(perception)
    voxels = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    ground = np.stack(np.meshgrid(x, y, [GROUND_M], indexing="ij"), axis=-1)[:, :, 0]
    return Coverage(
        {name: is_visible(camera, voxels, preprocessing) for name, camera in cameras.items()},
        {name: is_visible(camera, ground, preprocessing) for name, camera in cameras.items()},
    )


def voxel_centres(perception: PerceptionRange) -> tuple[Array, Array, Array]:
    """The coordinates [m] of the voxel centres along x, y and z."""
    x, y, z = (
        lower + (np.arange(count) + 0.5) * (upper - lower) / count
        for count, lower, upper in zip(perception.size, perception.lower_m, perception.upper_m, strict=True)
    )
    return x, y, z


def is_visible(camera: Camera, points: Array, preprocessing: Preprocessing | None) -> Mask:
    """Whether points (..., 3) [m] of the ego frame are in front of a camera and inside its image, (...).

    The rule is that of the exported graphs.
    """
    network_camera = preprocessed_camera(camera, preprocessing)
    with np.errstate(all="ignore"):
        pixels, depth_m = project(points, image_T_ego(network_camera.intrinsics_px, network_camera.camera_T_ego))
        is_inside = (pixels >= 0) & (pixels < (network_camera.width_px, network_camera.height_px))
        return (depth_m > NEAREST_DEPTH_M) & is_inside.all(axis=-1)


def preprocessed_camera(camera: Camera, preprocessing: Preprocessing | None) -> Camera:
    """The calibration of a camera's image after preprocessing; the given one if there is no preprocessing."""
    if preprocessing is None:
        return camera
    intrinsics_px = resize_transform(camera, preprocessing) @ camera.intrinsics_px
    return Camera(intrinsics_px, camera.camera_T_ego, preprocessing.width_px, preprocessing.height_px)


def nearest_ground_m(camera: Camera, preprocessing: Preprocessing | None) -> float:
    """The distance [m] from the point on the ground below a camera to the nearest visible ground; NaN without any.

    The visible part of the ground is convex. Its nearest point is on its border, unless the point below the camera is
    visible.
    """
    below = camera_pose(camera.camera_T_ego).position_m * (1, 1, 0) + (0, 0, GROUND_M)
    if is_visible(camera, below, preprocessing):
        return 0.0
    border = border_on_ground(preprocessed_camera(camera, preprocessing))
    distances_m = np.linalg.norm(border - below[:2], axis=-1)
    return float(np.nanmin(distances_m)) if np.isfinite(distances_m).any() else np.nan


def border_on_ground(camera: Camera) -> Array:
    """Points (K, 2) [m] where the rays through the image border meet the ground; NaN for rays that do not."""
    width, height = camera.width_px, camera.height_px
    along = np.linspace(0, 1, BORDER_POINTS)
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=np.float64)
    sides = corners[:, None] + along[:, None] * (np.roll(corners, -1, axis=0) - corners)[:, None]
    position = camera_pose(camera.camera_T_ego).position_m
    with np.errstate(all="ignore"):
        directions = pixel_rays(camera, sides.reshape(-1, 2)) @ camera.camera_T_ego[:3, :3]
        reach = (GROUND_M - position[2]) / directions[:, 2]
        return np.where(reach[:, None] > 0, position[:2] + reach[:, None] * directions[:, :2], np.nan)


def _count(masks: Mapping[str, Mask]) -> NDArray[np.int64]:
    return np.sum(list(masks.values()), axis=0, dtype=np.int64)
