"""Multi-scale deformable attention (MSDA), BEV and PV attention, and self-attention."""

import math
from collections.abc import Callable

import torch
from torch import Tensor, nn

from .config import DuoSpaceNetConfig
from .deformable_sampling import deformable_sampling, sample_and_sum
from .dropout import Dropout
from .image_encoder import NUM_LEVELS
from .projection import project
from .sampling import bev_locations
from .window import Window

Sampling = Callable[..., Tensor]  # with the arguments of `sample_and_sum`


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
    batch, num_queries, num_heads = sampling_locations.shape[:3]
    sizes = [(int(height), int(width)) for height, width in spatial_shapes]
    levels = [
        level.permute(0, 2, 3, 1).flatten(1, 2).unflatten(-1, size).split(1)
        for level, size in zip(value.split([height * width for height, width in sizes], dim=1), sizes, strict=True)
    ]
    # The locations are passed as offsets [cells] from the image corner.
    cells = sampling_locations * sampling_locations.new_tensor([[[width, height]] for height, width in sizes])
    visible = torch.ones(batch, 1, num_queries, dtype=torch.bool, device=value.device)
    images = [level[b] for b in range(batch) for level in levels]
    corner = value.new_zeros(batch, 1, 2, num_queries)
    return sample_and_sum(images, corner, visible, cells, attention_weights, num_heads).mT


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

    def forward(
        self,
        query: Tensor,
        locations: Tensor,
        visible: Tensor,
        values: list[list[Tensor]],
        sampling: Sampling = sample_and_sum,
    ) -> Tensor:
        """Attend around locations, in the values of each frame.

        query (T, Q, num_maps · C).
        locations (T, N, 2, Q): x and y as fractions of the image width and height.
        visible (T, N, Q) bool. The result is averaged over the cameras in which a location is visible. It is zero if
            there is none.
        values[t][j] (N, num_maps · C, H_j, W_j).
        sampling: the formula, or `deformable_sampling`, the operator of this formula. The operator is for values of
            several cameras, because its other form leaves out cameras.

        Returns (T, Q, num_maps · C), before the output projection.
        """
        offsets, weights = self.offsets_and_weights(query)
        weights = weights / visible.sum(dim=1).clamp(min=1)[..., None, None, None]
        levels = [level for frame in values for level in frame]
        return sampling(levels, locations, visible, offsets, weights, self.num_heads).mT

    def offsets_and_weights(self, query: Tensor) -> tuple[Tensor, Tensor]:
        """Sampling offsets from the locations [cells], and attention weights.

        query (T, Q, num_maps · C).

        Returns offsets (T, Q, heads, L, P, 2), x and y, and weights (T, Q, heads, L, P). The sum of the weights over L
        and P is 1.
        """
        sizes = self.num_levels, self.num_points
        offsets = self.offsets(query).unflatten(-1, (self.num_heads, *sizes, 2))
        weights = self.weights(query).unflatten(-1, (self.num_heads, -1)).softmax(dim=-1)
        return offsets, weights.unflatten(-1, sizes)

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

    def forward(self, query: Tensor, pose: Tensor, values: list[Tensor], window: Window) -> Tensor:
        """The queries of each frame attend to the values of the same frame.

        query (T, Q, C).
        pose (T, Q, 10): pose vectors in the ego frame of each frame.
        values[t] (1, C, X, Y).
        window: the valid frames.

        Returns (T, Q, C).
        """
        locations = bev_locations(pose[..., :2], self.voxels).mT[:, None]
        # An empty slot costs less time if nothing in it is visible.
        visible = window.frame_valid[:, None, None].expand(-1, 1, query.shape[1])
        return self.deformable.output(self.deformable(query, locations, visible, [[frame] for frame in values]))


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
        attended = self.deformable(query, locations, visible, values, deformable_sampling)
        # `where`, because the output projection adds its bias to a sum of zeros too.
        return torch.where(visible.any(dim=1)[..., None], self.deformable.output(attended), 0.0)


class SelfAttention(nn.Module):
    """Multi-head self-attention, MHSA (paper, eq. 4 with Q = K = V)."""

    def __init__(self, channels: int, num_heads: int) -> None:
        super().__init__()
        self.num_heads = num_heads
        self.query_key_value = nn.Linear(channels, 3 * channels)
        self.output = nn.Linear(channels, channels)
        self.dropout = Dropout()  # of the attention weights

    def forward(self, z: Tensor) -> Tensor:
        """Let every query attend to all queries. z (Q, C); returns (Q, C)."""
        num_queries, channels = z.shape
        projected = self.query_key_value(z).reshape(num_queries, 3, self.num_heads, -1)
        query, key, value = projected.permute(1, 2, 0, 3)
        # Written out: opset 20 has no Attention operator, so the exporter would decompose torch's attention anyway.
        scores = query @ key.mT / math.sqrt(channels // self.num_heads)
        weights = self.dropout(scores.softmax(dim=-1))
        return self.output((weights @ value).transpose(0, 1).reshape(num_queries, channels))
