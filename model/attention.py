"""Multi-scale deformable attention (MSDA) with grid_sample, BEV and PV attention, and self-attention."""

import math

import torch
from torch import Tensor, nn

from .config import DuoSpaceNetConfig
from .image_encoder import NUM_LEVELS
from .projection import project
from .sampling import bev_coordinates, sample
from .window import Window

FAR_OUTSIDE = -1e6  # a grid_sample coordinate so far outside that no predicted offset reaches the image


def multi_scale_deformable_attention(
    value: Tensor, spatial_shapes: Tensor, sampling_locations: Tensor, attention_weights: Tensor
) -> Tensor:
    """MSDA with the signature and layout of Deformable-DETR's reference function (Zhu et al., 2021, eq. 3).

    value (B, ΣHW, heads, C/heads): the levels, flattened and concatenated.
    spatial_shapes (L, 2): H and W of each level.
    sampling_locations (B, Q, heads, L, P, 2): x and y as fractions of a level's width and height. Outside [0, 1]
        the levels are padded with zeros.
    attention_weights (B, Q, heads, L, P).

    Returns (B, Q, C).
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
    """The sampling step of MSDA, for levels in image layout.

    levels[j] (B, C, H_j, W_j): the heads are consecutive groups of channels.
    grids (L, B, heads, P, Q, 2): grid_sample coordinates, -1 and 1 at the borders, zeros outside.

    Returns one tensor per level (B, heads, C/heads, P, Q).
    """
    _, batch, num_heads, num_points, num_queries, _ = grids.shape
    # onnxruntime (1.31) returns border values for huge coordinates, where torch returns zeros. At -2 and 2 both return
    # zeros for any level size, so the clamp changes no result.
    grids = grids.clamp(-2, 2)
    samples = []
    for level, grid in zip(levels, grids, strict=True):
        # Heads become images, because each head has its own sampling points. The split of the channels needs no copy.
        heads = level.reshape(batch * num_heads, -1, *level.shape[-2:])
        grid = grid.reshape(batch * num_heads, num_points, num_queries, 2)
        samples.append(sample(heads, grid).reshape(batch, num_heads, -1, num_points, num_queries))
    return samples


def weighted_sum(samples: list[Tensor], weights: Tensor) -> Tensor:
    """The weighting step of MSDA: the weighted sum over points and levels.

    samples: the result of `sample_levels`.
    weights (L, B, heads, P, Q).

    Returns (B, Q, C).
    """
    weighted = [(level * weight[:, :, None]).sum(dim=3) for level, weight in zip(samples, weights, strict=True)]
    return torch.stack(weighted).sum(dim=0).flatten(1, 2).mT


class DeformableAttention(nn.Module):
    """The layers of MSDA: value projection, sampling offsets, attention weights and output projection.

    channels: C, of one feature map.
    num_heads, num_points: heads per feature map, and sampling points per level and head.
    num_maps: number of feature maps, concatenated along the channels; 2 in BEVFormer's temporal self-attention. The
        queries have num_maps · C channels.
    """

    def __init__(self, channels: int, num_heads: int, num_levels: int, num_points: int, num_maps: int = 1) -> None:
        super().__init__()
        self.num_maps, self.num_levels, self.num_points = num_maps, num_levels, num_points
        self.num_heads = num_heads = num_maps * num_heads  # of all maps together
        query_channels = num_maps * channels
        # A 1×1 convolution instead of Deformable-DETR's linear layer: the values stay in image layout, as grid_sample
        # needs them, without a transposition.
        self.value = nn.Conv2d(channels, channels, 1)
        self.offsets = nn.Linear(query_channels, num_heads * num_levels * num_points * 2)
        self.weights = nn.Linear(query_channels, num_heads * num_levels * num_points)
        self.output = nn.Linear(channels, channels)
        nn.init.zeros_(self.offsets.weight)
        nn.init.zeros_(self.weights.weight)
        nn.init.zeros_(self.weights.bias)
        with torch.no_grad():
            self.offsets.bias.copy_(self.outward_offsets())

    def project_values(self, levels: list[Tensor]) -> list[Tensor]:
        """Project features (B, C, H_j, W_j) to attention values of the same shape.

        The values do not depend on the queries, so they are computed once per frame and cached.
        """
        return [self.value(level) for level in levels]

    def offsets_and_weights(self, query: Tensor, levels: list[Tensor]) -> tuple[Tensor, Tensor]:
        """Sampling offsets from the reference points, and attention weights.

        query (T, Q, num_maps · C).
        levels: L feature maps, of which only the sizes are used.

        Returns offsets (T, L, heads, P, Q, 2) and weights (T, L, heads, P, Q).
        The offsets are in grid_sample coordinates, in which each level is 2 wide and 2 high. The layer predicts them
        in cells of the level. The sum of the weights over L and P is 1.
        """
        # Offsets and weights are permuted here, because they are small. The large samples then need no permutation.
        num_heads, num_levels, num_points = self.num_heads, self.num_levels, self.num_points
        offsets = self.offsets(query).unflatten(-1, (num_heads, num_levels, num_points, 2))
        cells = [[2 / level.shape[-1], 2 / level.shape[-2]] for level in levels]
        offsets = offsets * torch.tensor(cells, dtype=query.dtype, device=query.device)[:, None]
        weights = self.weights(query).unflatten(-1, (num_heads, num_levels * num_points)).softmax(dim=-1)
        weights = weights.unflatten(-1, (num_levels, num_points))
        return offsets.permute(0, 3, 2, 4, 1, 5), weights.permute(0, 3, 2, 4, 1)

    def outward_offsets(self) -> Tensor:
        """Deformable-DETR's initial offsets [cells], flattened as the bias of `offsets`.

        The heads of a map have different directions. On every level, the larger coordinate of point p is p + 1 cells.
        """
        num_heads = self.num_heads // self.num_maps
        angle = torch.arange(num_heads) * (2 * math.pi / num_heads)
        direction = torch.stack((angle.cos(), angle.sin()), dim=-1)
        direction = direction / direction.abs().amax(dim=-1, keepdim=True)
        step = torch.arange(1, self.num_points + 1, dtype=torch.float32)[:, None]
        return (direction[:, None, None] * step).expand(-1, self.num_levels, -1, -1).reshape(-1).repeat(self.num_maps)


class BEVAttention(nn.Module):
    """MHCA_BEV (paper, eqs. 5-6): deformable attention in the BEV features around the x and y of the pose."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.voxels = config.voxels
        self.deformable = DeformableAttention(config.channels, config.num_heads, 1, config.bev_points)

    def project_values(self, bev: Tensor) -> Tensor:
        """Project F_BEV (1, C, X, Y) to attention values of the same shape."""
        return self.deformable.project_values([bev])[0]

    def forward(self, query: Tensor, pose: Tensor, values: list[Tensor], _window: Window) -> Tensor:
        """The queries of each frame attend to the values of the same frame.

        query (T, Q, C).
        pose (T, Q, 10): pose vectors in the ego frame of each frame.
        values[t] (1, C, X, Y).
        _window: not used. It is an argument so that both attentions have the same signature.

        Returns (T, Q, C).
        """
        reference = bev_coordinates(pose[..., :2], self.voxels)
        offsets, weights = self.deformable.offsets_and_weights(query, values[:1])
        grids = reference[:, None, None, None] + offsets
        # One call per frame. A batch over the frames would first copy the values of all frames into one tensor.
        attended = [
            weighted_sum(sample_levels([frame], grids[t][:, None]), weights[t][:, None])
            for t, frame in enumerate(values)
        ]
        return self.deformable.output(torch.cat(attended))


class PVAttention(nn.Module):
    """MHCA_PV (paper, eqs. 7-8): deformable attention in the PV features around the projected x, y, z of the pose.

    A query attends in every camera in which its reference point is visible. The results are averaged over these
    cameras. The result of a query without such a camera is exactly zero.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.image = config.image
        self.deformable = DeformableAttention(config.channels, config.num_heads, NUM_LEVELS, config.pv_points)

    def project_values(self, pv: list[Tensor]) -> list[Tensor]:
        """Project F_PV^j (N, C, H_j, W_j) to attention values of the same shapes."""
        return self.deformable.project_values(pv)

    def forward(self, query: Tensor, pose: Tensor, values: list[list[Tensor]], window: Window) -> Tensor:
        """The queries of each frame attend to the values of the same frame.

        query (T, Q, C).
        pose (T, Q, 10): pose vectors in the ego frame of each frame.
        values[t][j] (N, C, H_j, W_j).
        window: the calibration and the valid cameras of each frame.

        Returns (T, Q, C).
        """
        locations, visible = project(pose[..., :3], window.image_T_ego, self.image.width_px, self.image.height_px)
        visible = visible & window.camera_valid[..., None]
        # Static shapes allow no selection of the cameras per query, so all cameras are sampled. In a camera without the
        # reference point the samples are far outside the image, where they are zero.
        reference = torch.where(visible[..., None], 2 * locations - 1, FAR_OUTSIDE)
        offsets, weights = self.deformable.offsets_and_weights(query, values[0])
        weights = weights / visible.sum(dim=1).clamp(min=1)[:, None, None, None]
        grids = reference[:, None, :, None, None] + offsets[:, :, None]
        attended = [
            weighted_sum(_sum_over_cameras(sample_levels(frame, grids[t])), weights[t][:, None])
            for t, frame in enumerate(values)
        ]
        # `where`, because the output projection adds its bias to a sum of zeros too.
        return torch.where(visible.any(dim=1)[..., None], self.deformable.output(torch.cat(attended)), 0.0)


def _sum_over_cameras(samples: list[Tensor]) -> list[Tensor]:
    return [level.sum(dim=0, keepdim=True) for level in samples]


class SelfAttention(nn.Module):
    """Multi-head self-attention, MHSA (paper, eq. 4 with Q = K = V)."""

    def __init__(self, channels: int, num_heads: int) -> None:
        super().__init__()
        self.num_heads = num_heads
        self.query_key_value = nn.Linear(channels, 3 * channels)
        self.output = nn.Linear(channels, channels)

    def forward(self, z: Tensor) -> Tensor:
        """Let every query attend to all queries. z (Q, C); returns (Q, C)."""
        num_queries, channels = z.shape
        projected = self.query_key_value(z).reshape(num_queries, 3, self.num_heads, -1)
        query, key, value = projected.permute(1, 2, 0, 3)
        # Written out: opset 20 has no Attention operator, so the exporter would decompose torch's attention anyway.
        scores = query @ key.mT / math.sqrt(channels // self.num_heads)
        return self.output((scores.softmax(dim=-1) @ value).transpose(0, 1).reshape(num_queries, channels))
