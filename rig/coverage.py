"""What the cameras of a rig see of the space around it: voxels, the ground, directions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.bundle.manifest import PerceptionRange, Preprocessing
from ..runtime.frame import Camera
from ..runtime.geometry import NEAREST_DEPTH_M, image_T_ego, project
from ..runtime.preprocessing import resize_transform
from .optics import pose, rays

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

GROUND_M = 0.0  # the height of the road in the ego frame
BORDER_POINTS = 201  # along each side of a picture
SECTOR_DEG = 1.0
RING_STEP_M = 1.0
NEAR_M = 5.0  # nearer ground lies below the cameras of any rig, on one side or the other


@dataclass(frozen=True)
class Coverage:
    """Who sees what, by camera. voxels: masks (X, Y, Z) of the voxels' centres; ground: (X, Y), at the road's height.

    The cell [i, j] is at x_i (forward) and y_j (left).
    """

    voxels: Mapping[str, Mask]
    ground: Mapping[str, Mask]

    def share(self, name: str) -> float:
        """Of the voxels, those that a camera sees."""
        return float(self.voxels[name].mean())

    def ground_share(self, name: str) -> float:
        """Of the ground's cells, those that a camera sees."""
        return float(self.ground[name].mean())

    def share_alone(self, name: str) -> float:
        """Of the voxels, those that a camera sees and no other."""
        return float((self.voxels[name] & (_count(self.voxels) == 1)).mean()) if name in self.voxels else 0.0

    def overlap(self, one: str, other: str) -> float:
        """Of the voxels that either of two cameras sees, those that both see."""
        either = (self.voxels[one] | self.voxels[other]).sum()
        return float((self.voxels[one] & self.voxels[other]).sum() / either) if either else 0.0

    def shares_by_count(self) -> dict[str, float]:
        """Of the voxels, those that 0, 1, 2, and 3 or more cameras see."""
        count = _count(self.voxels)
        shares = {str(number): float((count == number).mean()) for number in range(3)}
        return shares | {"3+": float((count >= 3).mean())}

    def ground_count(self) -> NDArray[np.int64]:
        """How many cameras see each cell (X, Y) of the ground."""
        return _count(self.ground)


class Sector(NamedTuple):
    """Directions in the ground plane, counter-clockwise from start, in [0, 360), to end: 0 ahead, 90 left."""

    start_deg: float
    end_deg: float


def cover(cameras: Mapping[str, Camera], perception: PerceptionRange, preprocessing: Preprocessing | None) -> Coverage:
    """Ask every camera for every voxel; preprocessing: where given, what is cut off the pictures is not seen."""
    x, y, z = axes(perception)
    voxels = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    ground = np.stack(np.meshgrid(x, y, [GROUND_M], indexing="ij"), axis=-1)[:, :, 0]
    return Coverage(
        {name: sees(camera, voxels, preprocessing) for name, camera in cameras.items()},
        {name: sees(camera, ground, preprocessing) for name, camera in cameras.items()},
    )


def axes(perception: PerceptionRange) -> tuple[Array, Array, Array]:
    """The coordinates of the voxels' centres along x, y and z."""
    x, y, z = (
        lower + (np.arange(count) + 0.5) * (upper - lower) / count
        for count, lower, upper in zip(perception.size, perception.lower_m, perception.upper_m, strict=True)
    )
    return x, y, z


def sees(camera: Camera, points: Array, preprocessing: Preprocessing | None) -> Mask:
    """Which points (..., 3) of the ego frame a camera sees: before it and inside its picture, as the graphs ask."""
    seen = through(camera, preprocessing)
    with np.errstate(all="ignore"):
        pixels, depth_m = project(points, image_T_ego(seen.intrinsics_px, seen.camera_T_ego))
        inside = (pixels >= 0) & (pixels < (seen.width_px, seen.height_px))
        return (depth_m > NEAREST_DEPTH_M) & inside.all(axis=-1)


def through(camera: Camera, preprocessing: Preprocessing | None) -> Camera:
    """The camera whose picture is what the network gets of this one's, or this one where no network is asked."""
    if preprocessing is None:
        return camera
    intrinsics_px = resize_transform(camera, preprocessing) @ camera.intrinsics_px
    return Camera(intrinsics_px, camera.camera_T_ego, preprocessing.width_px, preprocessing.height_px)


def nearest_ground_m(camera: Camera, preprocessing: Preprocessing | None) -> float:
    """How far from the point below a camera the ground begins that it sees; NaN where it sees none.

    The nearest point lies on the border of what is seen, unless the camera sees the point below itself.
    """
    foot = pose(camera.camera_T_ego).position_m * (1, 1, 0) + (0, 0, GROUND_M)
    if sees(camera, foot, preprocessing):
        return 0.0
    hits = border_on_ground(through(camera, preprocessing))
    distances_m = np.linalg.norm(hits - foot[:2], axis=-1)
    return float(np.nanmin(distances_m)) if np.isfinite(distances_m).any() else np.nan


def border_on_ground(camera: Camera) -> Array:
    """Where the rays through the border of a picture meet the ground: (K, 2) x and y [m], NaN where they do not."""
    width, height = camera.width_px, camera.height_px
    along = np.linspace(0, 1, BORDER_POINTS)
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height)], dtype=np.float64)
    sides = corners[:, None] + along[:, None] * (np.roll(corners, -1, axis=0) - corners)[:, None]
    position = pose(camera.camera_T_ego).position_m
    with np.errstate(all="ignore"):
        directions = rays(camera, sides.reshape(-1, 2)) @ camera.camera_T_ego[:3, :3]
        reach = (GROUND_M - position[2]) / directions[:, 2]
        return np.where(reach[:, None] > 0, position[:2] + reach[:, None] * directions[:, :2], np.nan)


def blind_sectors(
    cameras: Mapping[str, Camera], perception: PerceptionRange, preprocessing: Preprocessing | None
) -> list[Sector]:
    """The directions from the ego's origin in which less than half of the range's ground is seen, to one degree.

    Ground nearer than `NEAR_M` does not count. A direction in which the range has no other ground is not blind.
    """
    azimuths = np.radians(np.arange(0, 360, SECTOR_DEG) + SECTOR_DEG / 2)
    lower, upper = np.array(perception.lower_m[:2]), np.array(perception.upper_m[:2])
    distances = np.arange(NEAR_M + RING_STEP_M / 2, np.hypot(*np.maximum(abs(lower), abs(upper))), RING_STEP_M)
    directions = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros_like(azimuths)], axis=-1)
    points = directions[:, None] * distances[:, None] + (0, 0, GROUND_M)
    is_within: Mask = np.all((points[..., :2] >= lower) & (points[..., :2] <= upper), axis=-1)
    is_seen = np.zeros_like(is_within)
    for camera in cameras.values():
        is_seen |= sees(camera, points, preprocessing)
    is_blind: Mask = 2 * np.sum(is_within & is_seen, axis=1) < np.sum(is_within, axis=1)
    return _runs(is_blind)


def _runs(is_blind: Mask) -> list[Sector]:
    """The runs of a ring of sectors."""
    if is_blind.all():
        return [Sector(0.0, 360.0)]
    starts = np.flatnonzero(is_blind & ~np.roll(is_blind, 1))
    ends = np.flatnonzero(is_blind & ~np.roll(is_blind, -1)) + 1
    if len(ends) and ends[0] <= starts[0]:
        ends = np.roll(ends, -1)
        ends[-1] += len(is_blind)
    return [Sector(float(start), float(end)) for start, end in zip(starts * SECTOR_DEG, ends * SECTOR_DEG, strict=True)]


def _count(masks: Mapping[str, Mask]) -> NDArray[np.int64]:
    return np.sum(list(masks.values()), axis=0, dtype=np.int64)
