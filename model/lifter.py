"""Voxel features from PV features, by parameter-free sampling (Harley et al., 2023; paper, "Feature extraction")."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from .config import DuoSpaceNetConfig
from .deformable_sampling import deformable_sampling
from .projection import axis_centres, project_grid


class LiftingTables(NamedTuple):
    """The locations of the voxels in the cameras. They change only with the calibration.

    voxel_locations (N, 2, Z·X·Y): x and y as fractions of the image width and height; outside if not visible.
    voxel_visible (N, Z·X·Y) bool: whether the voxel is visible in the camera.
    """

    voxel_locations: Tensor
    voxel_visible: Tensor


class Projector(nn.Module):
    """Computes the lifting tables of a calibration."""

    x: Tensor
    y: Tensor
    z: Tensor

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.image = config.image
        # Buffers, so that the graph holds the centres and does not compute them.
        for name, centres in zip("xyz", axis_centres(config.voxels), strict=True):
            self.register_buffer(name, centres, persistent=False)

    def forward(self, image_T_ego: Tensor, camera_valid: Tensor) -> LiftingTables:
        """Compute the lifting tables.

        image_T_ego (N, 3, 4) [px]: from the ego frame to pixels of the images.
        camera_valid (N) bool: False for a lost camera.
        """
        axes = self.x, self.y, self.z
        # A matrix of zeros projects every point to the depth 0, where it is not visible.
        image_T_ego = torch.where(camera_valid[:, None, None], image_T_ego, 0.0)
        return LiftingTables(*project_grid(axes, image_T_ego, self.image.width_px, self.image.height_px))


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

    def reduce(self, pv: list[Tensor]) -> list[Tensor]:
        """Reduce the channels of F_PV^j (N, C, H_j, W_j) to (N, voxel_channels, H_j, W_j)."""
        return [self.reduction(level) for level in pv]

    def forward(self, levels: list[Tensor], tables: LiftingTables) -> Tensor:
        """Sample the levels from `reduce`. Returns F_voxel (1, voxel_channels, Z, X, Y)."""
        num_x, num_y, num_z = self.voxels.size
        locations, visible = (table[None] for table in tables)
        voxels = deformable_sampling(levels, locations, visible, None, None, num_heads=1)
        # The clamp avoids a division by 0. Without a camera the sum is 0 as well.
        voxels = voxels / (visible.sum(dim=1).clamp(min=1) * len(levels))
        # Z is the first of the three axes, so that flattening it into the channels needs no copy.
        return voxels.unflatten(-1, (num_z, num_x, num_y))
