"""Projection of points of the ego frame into the cameras, and the cell centres of the voxel grid."""

import torch
from torch import Tensor

from .config import VoxelGrid

OUTSIDE = -1.0  # a location (fraction of an image) at which even the smallest level samples its zero padding
NEAREST_DEPTH_M = 0.1  # what lies nearer to a camera's plane, or behind it, is not seen


def axis_centres(voxels: VoxelGrid) -> list[Tensor]:
    """The centres of the cells along x (X), y (Y) and z (Z) [m] in the ego frame; float64."""
    return [
        lower + (torch.arange(count, dtype=torch.float64) + 0.5) * (upper - lower) / count
        for count, lower, upper in zip(voxels.size, voxels.lower_m, voxels.upper_m, strict=True)
    ]


def project(points: Tensor, image_T_ego: Tensor, width_px: int, height_px: int) -> tuple[Tensor, Tensor]:
    """Project points of the ego frame into every camera.

    points (..., Q, 3) [m]; image_T_ego (..., N, 3, 4) [px].
    Returns locations (..., N, Q, 2) as fractions (u / width, v / height) of the image, and `seen` (..., N, Q): in front
    of the camera by more than NEAREST_DEPTH_M, and inside the image. Locations of points not seen are OUTSIDE.

    The arithmetic is float64: which side of an image border a point lies on must not hang on the order in
    which an engine adds.
    """
    points, image_T_ego = points.double(), image_T_ego.double()
    homogeneous = points[..., None, :, :] @ image_T_ego[..., :3].mT + image_T_ego[..., None, :, 3]
    depth_m = homogeneous[..., 2]
    size_px = torch.tensor([width_px, height_px], dtype=torch.float64, device=points.device)
    locations = homogeneous[..., :2] / depth_m.clamp(min=NEAREST_DEPTH_M)[..., None] / size_px
    inside = (locations >= 0) & (locations < 1)
    seen = (depth_m > NEAREST_DEPTH_M) & inside[..., 0] & inside[..., 1]
    return torch.where(seen[..., None], locations, OUTSIDE).float(), seen
