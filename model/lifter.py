"""Voxel features from PV features, by parameter-free sampling (Harley et al., 2023; paper, "Feature extraction")."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from .config import DuoSpaceNetConfig
from .projection import OUTSIDE, axis_centres, project
from .sampling import sample


class LiftingTables(NamedTuple):
    """The sampling positions of the voxels in the cameras. They change only with the calibration.

    sampling_grid (N, Z·X, Y, 2): grid_sample coordinates, outside the image if the voxel is not visible.
    voxel_weight (1, Z·X, Y): 1 / the number of cameras in which the voxel is visible; 0 for a number of 0.
    """

    sampling_grid: Tensor
    voxel_weight: Tensor


class Projector(nn.Module):
    """Computes the lifting tables of a calibration."""

    voxel_centres: Tensor

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.image = config.image
        self.voxels = config.voxels
        # A buffer, so that the graph holds the centres and does not compute them. The exporter folds a computation to a
        # constant only up to 512×512 numbers.
        self.register_buffer("voxel_centres", _voxel_centres(config), persistent=False)

    def forward(self, image_T_ego: Tensor, camera_valid: Tensor) -> LiftingTables:
        """Compute the lifting tables.

        image_T_ego (N, 3, 4) [px]: from the ego frame to pixels of the images.
        camera_valid (N) bool: False for a lost camera.
        """
        num_x, num_y, num_z = self.voxels.size
        locations, visible = project(self.voxel_centres, image_T_ego, self.image.width_px, self.image.height_px)
        visible = visible & camera_valid[:, None]
        grid = 2 * torch.where(visible[..., None], locations, OUTSIDE) - 1
        num_visible = visible.float().sum(dim=0)
        # The clamp avoids a division by 0, also in the branch that `where` does not select.
        weight = torch.where(num_visible > 0, 1 / num_visible.clamp(min=1), 0.0)
        # Z and X share one axis, because 4-D sampling is much faster in onnxruntime than 5-D sampling.
        return LiftingTables(grid.reshape(-1, num_z * num_x, num_y, 2), weight.reshape(1, num_z * num_x, num_y))


class Lifter(nn.Module):
    """Samples each level at the projected voxel centres, and averages the samples of each voxel.

    The average is over the levels and over the cameras in which the voxel is visible.
    A 1×1 convolution reduces the channels before the sampling, because it is faster to sample fewer channels. It has
    no bias. The order of the two steps therefore does not change the result.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.voxels = config.voxels
        self.reduction = nn.Conv2d(config.channels, config.voxel_channels, 1, bias=False)

    def forward(self, pv: list[Tensor], tables: LiftingTables) -> Tensor:
        """Convert F_PV^j (N, C, H_j, W_j) to F_voxel (1, voxel_channels, Z, X, Y)."""
        num_x, num_y, num_z = self.voxels.size
        # The sum over the cameras is taken level by level: the samples of one level are the model's largest tensor.
        levels = (sample(self.reduction(level), tables.sampling_grid).sum(dim=0) for level in pv)
        voxels = sum(levels) * (tables.voxel_weight / len(pv))
        # Z is the first of the three axes, so that flattening it into the channels needs no copy.
        return voxels.reshape(1, -1, num_z, num_x, num_y)


def _voxel_centres(config: DuoSpaceNetConfig) -> Tensor:
    """The voxel centres (Z·X·Y, 3) [m] in the ego frame; z varies slowest and y fastest."""
    x, y, z = torch.meshgrid(*axis_centres(config.voxels), indexing="ij")
    return torch.stack((x, y, z), dim=-1).permute(2, 0, 1, 3).reshape(-1, 3)
