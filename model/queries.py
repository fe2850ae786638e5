"""Duo space queries: a pose vector shared by both spaces, and a content embedding for each."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from .config import DuoSpaceNetConfig


class Content(NamedTuple):
    """The content embeddings Q_BEV and Q_PV, (Q, C) each; or what has become of them in a decoder layer."""

    bev: Tensor
    pv: Tensor


class DuoSpaceQueries(nn.Module):
    """Paper, "Duo space queries". The pose vectors start as K-means centroids where training has them."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.pose = nn.Parameter(spread_poses(config))
        self.bev_content = nn.Parameter(torch.zeros(config.num_queries, config.channels))
        self.pv_content = nn.Parameter(torch.zeros(config.num_queries, config.channels))
        nn.init.normal_(self.bev_content)
        nn.init.normal_(self.pv_content)

    def forward(self) -> tuple[Content, Tensor]:
        """The content embeddings and the pose vectors 𝒫 (Q, 10)."""
        return Content(self.bev_content, self.pv_content), self.pose


class PoseEncoder(nn.Module):
    """ξ(Enc(𝒫)) (paper, eq. 1): fully connected layers, and a linear map to the width of the content."""

    unit: Tensor

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        channels = config.channels
        # Brings metres, logarithms, sines and metres per second to about one.
        unit = torch.tensor([*config.voxels.upper_m, 1, 1, 1, 1, 1, 10, 10], dtype=torch.float32)
        self.register_buffer("unit", unit, persistent=False)
        self.encoder = nn.Sequential(
            nn.Linear(10, channels),
            nn.ReLU(inplace=True),
            nn.LayerNorm(channels),
            nn.Linear(channels, channels),
            nn.ReLU(inplace=True),
            nn.LayerNorm(channels),
        )
        self.xi = nn.Linear(channels, channels)

    def forward(self, pose: Tensor) -> Tensor:
        """pose (..., 10); returns Q_Pose (..., C)."""
        return self.xi(self.encoder(pose / self.unit))


def spread_poses(config: DuoSpaceNetConfig, generator: torch.Generator | None = None) -> Tensor:
    """Pose vectors (Q, 10) all over the perception range, a metre above the ground, car-sized, looking ahead."""
    lower, upper = torch.tensor(config.voxels.lower_m[:2]), torch.tensor(config.voxels.upper_m[:2])
    pose = torch.zeros(config.num_queries, 10)
    pose[:, :2] = lower + torch.rand(config.num_queries, 2, generator=generator) * (upper - lower)
    pose[:, 2] = 1.0
    pose[:, 3:6] = torch.tensor([2.0, 4.5, 1.7]).log()
    pose[:, 7] = 1.0
    return pose
