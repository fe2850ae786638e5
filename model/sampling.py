"""Bilinear sampling of feature maps with one convention, and the locations of points in BEV features."""

import torch
import torch.nn.functional as F
from torch import Tensor

from .config import VoxelGrid


def sample(features: Tensor, grid: Tensor) -> Tensor:
    """Sample features bilinearly, with zeros outside.

    features (B, C, H, W).
    grid (B, H', W', 2): x and y, with -1 and 1 at the outer borders of the first and last pixel.

    Returns (B, C, H', W').
    """
    # onnxruntime's fast GridSample needs exactly these settings and 4-D features. It computes the positions once per
    # image and reuses them for all channels. With other settings it computes them again for every channel.
    return F.grid_sample(features, grid, mode="bilinear", padding_mode="zeros", align_corners=False)


def bev_locations(points_m: Tensor, voxels: VoxelGrid) -> Tensor:
    """Convert points (..., 2), x and y in the ego frame [m], to locations in BEV features.

    BEV features are images with the height X and the width Y, so the result is ordered (y, x), as fractions of the
    width and the height. It has the dtype of the points.
    """
    corners = [
        torch.tensor(corner[:2], dtype=points_m.dtype, device=points_m.device)
        for corner in (voxels.lower_m, voxels.upper_m)
    ]
    return ((points_m - corners[0]) / (corners[1] - corners[0])).flip(-1)
