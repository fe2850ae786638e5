"""Sampling of feature maps: the one convention of the house, and where a place on the ground lies in BEV features."""

import torch
import torch.nn.functional as F
from torch import Tensor

from .config import VoxelGrid


def sample(features: Tensor, grid: Tensor) -> Tensor:
    """features (B, C, H, W), bilinearly, zeros outside, at grid (B, H', W', 2): x, y with -1 and 1 the outer borders.

    Returns (B, C, H', W').
    """
    return F.grid_sample(features, grid, mode="bilinear", padding_mode="zeros", align_corners=False)


def bev_coordinates(points_m: Tensor, voxels: VoxelGrid) -> Tensor:
    """Points (..., 2), x and y in the ego frame [m], as `sample`'s coordinates in BEV features, in their own precision.

    Seen as a picture, the height of BEV features is x and their width is y.
    """
    corners = [
        torch.tensor(corner[:2], dtype=points_m.dtype, device=points_m.device)
        for corner in (voxels.lower_m, voxels.upper_m)
    ]
    return 2 * ((points_m - corners[0]) / (corners[1] - corners[0])).flip(-1) - 1
