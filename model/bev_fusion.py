"""Fusion of the BEV features of a window: the paper's two alternatives to temporal queries in BEV.

Both warp the features of each frame to the current ego frame, then fuse the frames from the oldest to the newest.
"""

import torch
from torch import Tensor, nn

from .attention import DeformableAttention
from .config import DuoSpaceNetConfig, VoxelGrid
from .projection import axis_centres
from .sampling import bev_locations, sample
from .window import Window

NUM_POINTS = 4  # sampling points per head and map of temporal self-attention, as in BEVFormer


class RecurrentStacking(nn.Module):
    """Paper, ablation of temporal modeling, "Recurrent Stacking".

    A convolution fuses each frame with the fused features of the frames before it, as in BEVDet4D (Huang and Huang,
    2022) and VideoBEV (Han et al., 2023). The initial state is zero. A masked frame does not change the state.
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
        """Fuse frames[t], F_BEV (1, C, X, Y) in the ego frame of frame t, to (1, C, X, Y) in the current ego frame."""
        state = torch.zeros_like(frames[0])
        for t, bev in reversed(list(enumerate(self.alignment(frames, window)))):
            state = torch.where(window.frame_valid[t], self.fuse(torch.cat((state, bev), dim=1)), state)
        return state


class TemporalSelfAttention(nn.Module):
    """Paper, ablation of temporal modeling, "Learnable Attention": BEVFormer's temporal self-attention.

    Each cell attends, around its own position, to the features of a frame and to the fused features of the frames
    before it (Li et al., 2022, eq. 5). As in BEVFormer, the oldest frame uses itself as its past. A masked frame does
    not change the state. The cells' queries are the features, without BEVFormer's positional embedding.
    """

    locations: Tensor

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.alignment = EgoAlignment(config.voxels)
        self.attention = DeformableAttention(config.channels, config.num_heads, 1, NUM_POINTS, num_maps=2)
        self.norm = nn.LayerNorm(config.channels)
        locations = bev_locations(_cell_centres(config.voxels), config.voxels).float().flatten(0, 1)
        self.register_buffer("locations", locations.mT[None, None], persistent=False)

    def forward(self, frames: list[Tensor], window: Window) -> Tensor:
        """Fuse frames[t], F_BEV (1, C, X, Y) in the ego frame of frame t, to (1, C, X, Y) in the current ego frame."""
        # `has_past` is a tensor and not a Python bool, because a traced graph has no branches.
        state, has_past = torch.zeros_like(frames[0]), torch.zeros_like(window.frame_valid[0])
        for t, bev in reversed(list(enumerate(self.alignment(frames, window)))):
            attended = self.attend(bev, torch.where(has_past, state, bev))
            state = torch.where(window.frame_valid[t], attended, state)
            has_past = has_past | window.frame_valid[t]
        return state

    def attend(self, bev: Tensor, past: Tensor) -> Tensor:
        """Fuse the features of a frame with those of its past. All are (1, C, X, Y) in the current ego frame."""
        # As in BEVFormer: each cell's query is its past and its current features, and it attends to two maps, the past
        # and the current one. Each map has its own heads. The result is the mean of the two.
        query = torch.cat((past, bev), dim=1).flatten(2).mT
        value = torch.cat(self.attention.project_values([past, bev]), dim=1)
        visible = torch.ones_like(self.locations[:, :, 0], dtype=torch.bool)
        attended = self.attention(query, self.locations, visible, [[value]])
        attended = self.attention.output(torch.stack(attended.chunk(2, dim=-1)).mean(dim=0))
        return self.norm(bev.flatten(2).mT + attended).mT.reshape(bev.shape)


FUSIONS = {"stacking": RecurrentStacking, "attention": TemporalSelfAttention}


class EgoAlignment(nn.Module):
    """Warps past BEV features to the current ego frame: bilinear sampling on the ground plane, with zeros outside."""

    cells: Tensor

    def __init__(self, voxels: VoxelGrid) -> None:
        super().__init__()
        self.voxels = voxels
        self.register_buffer("cells", _cell_centres(voxels), persistent=False)

    def forward(self, frames: list[Tensor], window: Window) -> list[Tensor]:
        """Warp frames[t] (1, C, X, Y) from the ego frame of frame t to the current ego frame, with the same shapes."""
        # In float64, PyTorch and onnxruntime round to the same float32 grid, although they add in different orders.
        past_points_m = (
            self.cells @ window.past_T_now[:, None, :2, :2].double().mT + window.past_T_now[:, None, None, :2, 3]
        )
        grids = (2 * bev_locations(past_points_m, self.voxels) - 1).clamp(-2, 2).float()
        aligned = [sample(frame, grids[t : t + 1]) for t, frame in enumerate(frames) if t > 0]
        # Frame 0 is not sampled: rounding of the grid would change its features.
        return [frames[0], *aligned]


def _cell_centres(voxels: VoxelGrid) -> Tensor:
    """The x and y of the cell centres (X, Y, 2) [m] in the ego frame; float64."""
    return torch.stack(torch.meshgrid(*axis_centres(voxels)[:2], indexing="ij"), dim=-1)
