"""PV features to voxels by parameter-free back-projection (Harley et al., 2023; paper, "Feature extraction")."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from .config import DuoSpaceNetConfig
from .projection import OUTSIDE, axis_centres, project
from .sampling import sample


class LiftingTables(NamedTuple):
    """Where every voxel looks in every camera; it changes only when the calibration does.

    sampling_grid (N, Z·X, Y, 2): grid_sample coordinates, outside of the image for a voxel not seen.
    voxel_weight (1, Z·X, Y): 1 / the number of cameras that see the voxel, 0 where none does.
    """

    sampling_grid: Tensor
    voxel_weight: Tensor


class Projector(nn.Module):
    """Calibration to lifting tables."""

    voxel_centres: Tensor

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.image = config.image
        self.voxels = config.voxels
        self.register_buffer("voxel_centres", _voxel_centres(config), persistent=False)

    def forward(self, image_T_ego: Tensor, camera_valid: Tensor) -> LiftingTables:
        """image_T_ego (N, 3, 4) [px]; camera_valid (N) bool."""
        num_x, num_y, num_z = self.voxels.size
        locations, seen = project(self.voxel_centres, image_T_ego, self.image.width_px, self.image.height_px)
        seen = seen & camera_valid[:, None]
        grid = 2 * torch.where(seen[..., None], locations, OUTSIDE) - 1
        num_seen = seen.float().sum(dim=0)
        weight = torch.where(num_seen > 0, 1 / num_seen.clamp(min=1), 0.0)
        return LiftingTables(grid.reshape(-1, num_z * num_x, num_y, 2), weight.reshape(1, num_z * num_x, num_y))


class Lifter(nn.Module):
    """Samples every level bilinearly at the projected voxel centres and averages over what sees the voxel.

    The 1×1 reduction of the channels stands before the sampling, with which it commutes (but for the bias,
    which it therefore does not have).
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.voxels = config.voxels
        self.reduction = nn.Conv2d(config.channels, config.voxel_channels, 1, bias=False)

    def forward(self, pv: list[Tensor], tables: LiftingTables) -> Tensor:
        """pv: F_PV^j (N, C, H_j, W_j); returns F_voxel (1, voxel_channels, Z, X, Y).

        Z stands first, so that flattening it into the channels moves nothing.
        """
        num_x, num_y, num_z = self.voxels.size
        # Summed over the cameras level by level: the samples of one level are the largest tensor there is.
        levels = (sample(self.reduction(level), tables.sampling_grid).sum(dim=0) for level in pv)
        voxels = sum(levels) * (tables.voxel_weight / len(pv))
        return voxels.reshape(1, -1, num_z, num_x, num_y)


def _voxel_centres(config: DuoSpaceNetConfig) -> Tensor:
    """The centres (Z·X·Y, 3) [m] in the ego frame, z slowest and y fastest."""
    x, y, z = torch.meshgrid(*axis_centres(config.voxels), indexing="ij")
    return torch.stack((x, y, z), dim=-1).permute(2, 0, 1, 3).reshape(-1, 3)
