"""The past in BEV without temporal queries: the paper's two other ways to fuse the BEV features of a window.

Both bring every frame's features to the current ego frame and take up one after the other, oldest first.
"""

import torch
from torch import Tensor, nn

from .attention import DeformableAttention, sample_levels, weighted_sum
from .config import DuoSpaceNetConfig, VoxelGrid
from .projection import axis_centres
from .sampling import bev_coordinates, sample
from .window import Window

NUM_POINTS = 4  # of temporal self-attention, a head and map, as in BEVFormer


class RecurrentStacking(nn.Module):
    """Paper, ablation of temporal modeling, "Recurrent Stacking": a frame is stacked on what came before it, and a
    convolution fuses the two (as BEVDet4D, Huang and Huang, 2022, and VideoBEV, Han et al., 2023).

    It starts from zeros; a masked frame changes nothing.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        channels = config.channels
        self.alignment = EgoAlignment(config.voxels)
        self.fuse = nn.Sequential(
            nn.Conv2d(2 * channels, channels, 3, padding=1, bias=False),
            nn.BatchNorm2d(channels),
            nn.ReLU(inplace=True),
        )

    def forward(self, frames: list[Tensor], window: Window) -> Tensor:
        """frames[t]: F_BEV (1, C, X, Y) in the ego frame of its time. Returns one of now."""
        state = torch.zeros_like(frames[0])
        for t, bev in reversed(list(enumerate(self.alignment(frames, window)))):
            state = torch.where(window.frame_valid[t], self.fuse(torch.cat((state, bev), dim=1)), state)
        return state


class TemporalSelfAttention(nn.Module):
    """Paper, ablation of temporal modeling, "Learnable Attention": BEVFormer's temporal self-attention (Li et al.,
    2022, eq. 5), in which every cell attends around its own place to the features of a frame and to what came before.

    As there, the first frame has itself for a past; a masked frame changes nothing. The cells' queries are the
    features alone: they say where things are, other than BEVFormer's, which need an embedding of their place for that.
    """

    reference: Tensor

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.alignment = EgoAlignment(config.voxels)
        self.attention = DeformableAttention(config.channels, config.num_heads, 1, NUM_POINTS, num_maps=2)
        self.norm = nn.LayerNorm(config.channels)
        own_places = bev_coordinates(_cell_centres(config.voxels), config.voxels).float().flatten(0, 1)
        self.register_buffer("reference", own_places, persistent=False)

    def forward(self, frames: list[Tensor], window: Window) -> Tensor:
        """frames[t]: F_BEV (1, C, X, Y) in the ego frame of its time. Returns one of now."""
        state, begun = torch.zeros_like(frames[0]), torch.zeros_like(window.frame_valid[0])
        for t, bev in reversed(list(enumerate(self.alignment(frames, window)))):
            attended = self.attend(bev, torch.where(begun, state, bev))
            state = torch.where(window.frame_valid[t], attended, state)
            begun = begun | window.frame_valid[t]
        return state

    def attend(self, bev: Tensor, past: Tensor) -> Tensor:
        """Features of a frame, and of what came before it, (1, C, X, Y) each and in one ego frame; returns the same."""
        query = torch.cat((past, bev), dim=1).flatten(2).mT
        value = torch.cat(self.attention.values([past, bev]), dim=1)
        offsets, weights = self.attention.points(query, [value])
        grids = (self.reference + offsets)[:, 0, None]
        attended = weighted_sum(sample_levels([value], grids), weights[:, 0, None])
        attended = self.attention.output(torch.stack(attended.chunk(2, dim=-1)).mean(dim=0))
        return self.norm(bev.flatten(2).mT + attended).mT.reshape(bev.shape)


FUSIONS = {"stacking": RecurrentStacking, "attention": TemporalSelfAttention}


class EgoAlignment(nn.Module):
    """Past BEV features as the current ego frame sees them: sampled bilinearly on the ground, zeros outside."""

    cells: Tensor

    def __init__(self, voxels: VoxelGrid) -> None:
        super().__init__()
        self.voxels = voxels
        self.register_buffer("cells", _cell_centres(voxels), persistent=False)

    def forward(self, frames: list[Tensor], window: Window) -> list[Tensor]:
        """frames[t] (1, C, X, Y); returns the same, all in the ego frame of now."""
        places = self.cells @ window.past_T_now[:, None, :2, :2].double().mT + window.past_T_now[:, None, None, :2, 3]
        grids = bev_coordinates(places, self.voxels).clamp(-2, 2).float()
        moved = [sample(frame, grids[t : t + 1]) for t, frame in enumerate(frames) if t > 0]
        return [frames[0], *moved]


def _cell_centres(voxels: VoxelGrid) -> Tensor:
    """The cells' centres (X, Y, 2) [m] on the ground, which is the ego frame's z = 0; float64."""
    return torch.stack(torch.meshgrid(*axis_centres(voxels)[:2], indexing="ij"), dim=-1)
