"""Duo space queries: a pose vector for both spaces, and a content embedding for each space."""

import torch
from torch import Tensor, nn

from .config import DuoSpaceNetConfig


class DuoSpaceQueries(nn.Module):
    """Paper, "Duo space queries": learned pose vectors and content embeddings.

    The content is Q_BEV ⊕ Q_PV (Q, 2C), or (Q, C) in the ablations with one content embedding. Training replaces the
    initial positions by K-means centroids.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.pose = nn.Parameter(initial_poses(config))
        self.content = nn.Parameter(torch.randn(config.num_queries, config.content_channels))

    def forward(self) -> tuple[Tensor, Tensor]:
        """Return the content embeddings (Q, content channels) and the pose vectors 𝒫 (Q, 10)."""
        return self.content, self.pose


class PoseEncoder(nn.Module):
    """Encodes pose vectors as ξ(Enc(𝒫)) (paper, eq. 1): fully connected layers, then a linear layer."""

    unit: Tensor

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        channels = config.channels
        # Positions are divided by the range [m] and velocities by 10 m/s, so that all inputs are about one.
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
        """Encode pose vectors (..., 10) as Q_Pose (..., C)."""
        return self.xi(self.encoder(pose / self.unit))


def initial_poses(config: DuoSpaceNetConfig, generator: torch.Generator | None = None) -> Tensor:
    """Random pose vectors (Q, 10): uniform over the perception range, at z = 1 m, of a car's size, with yaw 0."""
    lower, upper = torch.tensor(config.voxels.lower_m[:2]), torch.tensor(config.voxels.upper_m[:2])
    pose = torch.zeros(config.num_queries, 10)
    pose[:, :2] = lower + torch.rand(config.num_queries, 2, generator=generator) * (upper - lower)
    pose[:, 2] = 1.0
    pose[:, 3:6] = torch.tensor([2.0, 4.5, 1.7]).log()
    pose[:, 7] = 1.0
    return pose


@torch.no_grad()
def place_anchors(pose: Tensor, centres_m: Tensor) -> None:
    """Set the positions of pose vectors (..., Q, 10) to centres (Q, 3) [m] in the ego frame, in place.

    The other numbers of the pose vectors do not change.
    Raises ValueError unless there is one centre per query and all numbers are finite.
    """
    if centres_m.shape != (pose.shape[-2], 3):
        expected, got = (pose.shape[-2], 3), tuple(centres_m.shape)
        raise ValueError(f"anchors: expected one centre per query, shape {expected}; got {got}")
    if not bool(centres_m.isfinite().all()):
        raise ValueError("anchors: expected finite metres; got NaN or Inf")
    pose[..., :3] = centres_m.to(pose)


@torch.no_grad()
def resize_anchors(pose: Tensor, size_m: Tensor) -> None:
    """Set the sizes of pose vectors (..., Q, 10) to the width, length and height (3) [m], in place."""
    pose[..., 3:6] = size_m.log().to(pose)
