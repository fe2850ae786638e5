"""Attention: multi-scale deformable attention (MSDA) in grid_sample ops, its two spaces, and self-attention."""

import math

import torch
from torch import Tensor, nn

from .config import DuoSpaceNetConfig
from .image_encoder import NUM_LEVELS
from .projection import project
from .sampling import bev_coordinates, sample
from .window import Window

FAR_OUTSIDE = -1e6  # a grid_sample coordinate from which no offset leads back into an image


def multi_scale_deformable_attention(
    value: Tensor, spatial_shapes: Tensor, sampling_locations: Tensor, attention_weights: Tensor
) -> Tensor:
    """MSDA with the signature and layout of Deformable-DETR's reference function (Zhu et al., 2021, eq. 3).

    value (B, ΣHW, heads, C/heads), the levels one after the other; spatial_shapes (L, 2): H, W of each level;
    sampling_locations (B, Q, heads, L, P, 2): x, y in [0, 1] of a level's width and height, zeros outside;
    attention_weights (B, Q, heads, L, P). Returns (B, Q, C).
    """
    batch, _, num_heads, head_channels = value.shape
    shapes = [(int(height), int(width)) for height, width in spatial_shapes]
    levels = [
        level.permute(0, 2, 3, 1).reshape(batch, num_heads * head_channels, height, width)
        for level, (height, width) in zip(
            value.split([height * width for height, width in shapes], dim=1), shapes, strict=True
        )
    ]
    grids = (2 * sampling_locations - 1).permute(3, 0, 2, 4, 1, 5)
    return weighted_sum(sample_levels(levels, grids), attention_weights.permute(3, 0, 2, 4, 1))


def sample_levels(levels: list[Tensor], grids: Tensor) -> list[Tensor]:
    """The sampling half of MSDA, on levels that lie as images: `levels[j]` (B, C, H_j, W_j), heads along C.

    grids (L, B, heads, P, Q, 2): grid_sample's coordinates, -1 and 1 the borders, zeros outside.
    Returns a level each (B, heads, C/heads, P, Q).
    """
    _, batch, num_heads, num_points, num_queries, _ = grids.shape
    # Beyond -2 and 2 there are only zeros, but onnxruntime samples the border at huge coordinates.
    grids = grids.clamp(-2, 2)
    samples = []
    for level, grid in zip(levels, grids, strict=True):
        heads = level.reshape(batch * num_heads, -1, *level.shape[-2:])
        grid = grid.reshape(batch * num_heads, num_points, num_queries, 2)
        samples.append(sample(heads, grid).reshape(batch, num_heads, -1, num_points, num_queries))
    return samples


def weighted_sum(samples: list[Tensor], weights: Tensor) -> Tensor:
    """The weighing half of MSDA: samples of `sample_levels`, weights (L, B, heads, P, Q). Returns (B, Q, C)."""
    weighed = [(level * weight[:, :, None]).sum(dim=3) for level, weight in zip(samples, weights, strict=True)]
    return torch.stack(weighed).sum(dim=0).flatten(1, 2).mT


class DeformableAttention(nn.Module):
    """The learned part of MSDA: values, sampling offsets, attention weights and the output projection.

    num_maps: how many values lie side by side in the channels, each with heads and queries' channels of its own.
    """

    def __init__(self, channels: int, num_heads: int, num_levels: int, num_points: int, num_maps: int = 1) -> None:
        super().__init__()
        self.num_maps, num_heads, query_channels = num_maps, num_maps * num_heads, num_maps * channels
        self.shape = (num_heads, num_levels, num_points)
        self.value = nn.Conv2d(channels, channels, 1)
        self.offsets = nn.Linear(query_channels, num_heads * num_levels * num_points * 2)
        self.weights = nn.Linear(query_channels, num_heads * num_levels * num_points)
        self.output = nn.Linear(channels, channels)
        nn.init.zeros_(self.offsets.weight)
        nn.init.zeros_(self.weights.weight)
        nn.init.zeros_(self.weights.bias)
        with torch.no_grad():
            self.offsets.bias.copy_(self.outward_offsets())

    def values(self, levels: list[Tensor]) -> list[Tensor]:
        """Project features (B, C, H_j, W_j) to the values that are sampled. Done once a frame, not a query."""
        return [self.value(level) for level in levels]

    def points(self, query: Tensor, levels: list[Tensor]) -> tuple[Tensor, Tensor]:
        """Where queries (T, Q, maps · C) look from their reference points, and how much each place counts.

        Returns offsets (T, L, heads, P, Q, 2) on the scale of grid_sample's coordinates, for which the width or the
        height of a level is 2 (they are learned in its cells); and weights (T, L, heads, P, Q), which sum to 1 over
        L and P. They lie as `sample_levels` takes them: what is made of them is large, and need not be moved.
        """
        num_heads, num_levels, num_points = self.shape
        offsets = self.offsets(query).unflatten(-1, (num_heads, num_levels, num_points, 2))
        cells = [[2 / level.shape[-1], 2 / level.shape[-2]] for level in levels]
        offsets = offsets * torch.tensor(cells, dtype=query.dtype, device=query.device)[:, None]
        weights = self.weights(query).unflatten(-1, (num_heads, num_levels * num_points)).softmax(dim=-1)
        weights = weights.unflatten(-1, (num_levels, num_points))
        return offsets.permute(0, 3, 2, 4, 1, 5), weights.permute(0, 3, 2, 4, 1)

    def outward_offsets(self) -> Tensor:
        """Deformable-DETR's start: heads of a map look their own ways, points a cell further each, levels alike."""
        num_heads, num_levels, num_points = self.shape
        num_heads //= self.num_maps
        angle = torch.arange(num_heads) * (2 * math.pi / num_heads)
        direction = torch.stack((angle.cos(), angle.sin()), dim=-1)
        direction = direction / direction.abs().amax(dim=-1, keepdim=True)
        step = torch.arange(1, num_points + 1, dtype=torch.float32)[:, None]
        return (direction[:, None, None] * step).expand(-1, num_levels, -1, -1).reshape(-1).repeat(self.num_maps)


class BEVAttention(nn.Module):
    """MHCA_BEV (paper, eqs. 5-6): the reference point is the pose's x and y as a place in the BEV features."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.voxels = config.voxels
        self.deformable = DeformableAttention(config.channels, config.num_heads, 1, config.bev_points)

    def values(self, bev: Tensor) -> Tensor:
        """F_BEV (1, C, X, Y) to values of the same shape."""
        return self.deformable.values([bev])[0]

    def forward(self, query: Tensor, pose: Tensor, values: list[Tensor], _window: Window) -> Tensor:
        """Every frame's queries attend to that frame's values.

        query (T, Q, C); pose (T, Q, 10), each in its frame's ego frame; values[t] (1, C, X, Y). Returns (T, Q, C).
        """
        reference = bev_coordinates(pose[..., :2], self.voxels)
        offsets, weights = self.deformable.points(query, values[:1])
        grids = reference[:, None, None, None] + offsets
        attended = [
            weighted_sum(sample_levels([frame], grids[t][:, None]), weights[t][:, None])
            for t, frame in enumerate(values)
        ]
        return self.deformable.output(torch.cat(attended))


class PVAttention(nn.Module):
    """MHCA_PV (paper, eqs. 7-8): the reference point is the pose's x, y, z projected into every camera.

    A query attends in every camera that sees its reference point; the results are averaged over those cameras, and
    are zero where none does.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.image = config.image
        self.deformable = DeformableAttention(config.channels, config.num_heads, NUM_LEVELS, config.pv_points)

    def values(self, pv: list[Tensor]) -> list[Tensor]:
        """F_PV^j (N, C, H_j, W_j) to values of the same shapes."""
        return self.deformable.values(pv)

    def forward(self, query: Tensor, pose: Tensor, values: list[list[Tensor]], window: Window) -> Tensor:
        """Every frame's queries attend to that frame's values.

        query (T, Q, C); pose (T, Q, 10), each in its frame's ego frame; values[t][j] (N, C, H_j, W_j);
        window: the calibration and the cameras of each frame. Returns (T, Q, C).
        """
        locations, seen = project(pose[..., :3], window.image_T_ego, self.image.width_px, self.image.height_px)
        seen = seen & window.camera_valid[..., None]
        # A camera that does not see the reference point is sampled far outside of its image, where all is zero.
        reference = torch.where(seen[..., None], 2 * locations - 1, FAR_OUTSIDE)
        offsets, weights = self.deformable.points(query, values[0])
        weights = weights / seen.sum(dim=1).clamp(min=1)[:, None, None, None]
        grids = reference[:, None, :, None, None] + offsets[:, :, None]
        attended = [
            weighted_sum(_add_cameras(sample_levels(frame, grids[t])), weights[t][:, None])
            for t, frame in enumerate(values)
        ]
        return torch.where(seen.any(dim=1)[..., None], self.deformable.output(torch.cat(attended)), 0.0)


def _add_cameras(samples: list[Tensor]) -> list[Tensor]:
    return [level.sum(dim=0, keepdim=True) for level in samples]


class SelfAttention(nn.Module):
    """MHSA (paper, eq. 4 with Q = K = V)."""

    def __init__(self, channels: int, num_heads: int) -> None:
        super().__init__()
        self.num_heads = num_heads
        self.query_key_value = nn.Linear(channels, 3 * channels)
        self.output = nn.Linear(channels, channels)

    def forward(self, z: Tensor) -> Tensor:
        """z (Q, C); returns (Q, C)."""
        num_queries, channels = z.shape
        projected = self.query_key_value(z).reshape(num_queries, 3, self.num_heads, -1)
        query, key, value = projected.permute(1, 2, 0, 3)
        scores = query @ key.mT / math.sqrt(channels // self.num_heads)
        return self.output((scores.softmax(dim=-1) @ value).transpose(0, 1).reshape(num_queries, channels))
