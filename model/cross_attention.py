"""Space-specific temporal cross-attention, and one combination of it for each kind of object queries."""

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from .attention import BEVAttention, PVAttention
from .config import DuoSpaceNetConfig
from .dropout import Dropout
from .window import TemporalQueries, Window


class LayerCache(NamedTuple):
    """The attention values of a window for one decoder layer, index 0 the newest frame.

    pv[t][j] (N, C, H_j, W_j).
    bev[t] (1, C, X, Y). With a BEV fusion there is only one element, the fused features.
    """

    pv: list[list[Tensor]]
    bev: list[Tensor]


class DuoSpaceAttention(nn.Module):
    """The paper's attention. The content of a query is BEV ⊕ PV along the channels; each half attends to its space."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.bev = TemporalCrossAttention(BEVAttention(config), config.channels)
        self.pv = TemporalCrossAttention(PVAttention(config), config.channels)

    def forward(self, content: Tensor, queries: TemporalQueries, cache: LayerCache, window: Window) -> Tensor:
        """content (Q, 2C); returns the new content (Q, 2C)."""
        bev, pv = content.chunk(2, dim=-1)
        return torch.cat((self.bev(bev, queries, cache.bev, window), self.pv(pv, queries, cache.pv, window)), dim=-1)


class SharedContentAttention(nn.Module):
    """Paper, ablation of the queries, "shared pose and shared content": attention in PV, then in BEV."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.pv = TemporalCrossAttention(PVAttention(config), config.channels)
        self.bev = TemporalCrossAttention(BEVAttention(config), config.channels)

    def forward(self, content: Tensor, queries: TemporalQueries, cache: LayerCache, window: Window) -> Tensor:
        """content (Q, C); returns the new content (Q, C)."""
        return self.bev(self.pv(content, queries, cache.pv, window), queries, cache.bev, window)


class UnsharedAttention(nn.Module):
    """Paper, ablation of the queries, "unshared pose and unshared content": a set of queries for each space.

    The first half of the queries attends in BEV, the second half in PV.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.bev = TemporalCrossAttention(BEVAttention(config), config.channels)
        self.pv = TemporalCrossAttention(PVAttention(config), config.channels)

    def forward(self, content: Tensor, queries: TemporalQueries, cache: LayerCache, window: Window) -> Tensor:
        """content (Q, C); returns the new content (Q, C)."""
        (bev, pv), (bev_queries, pv_queries) = content.chunk(2), queries.halves()
        return torch.cat((self.bev(bev, bev_queries, cache.bev, window), self.pv(pv, pv_queries, cache.pv, window)))


class BEVOnlyAttention(nn.Module):
    """Paper, ablation of the spaces, "BEV Only": attention in BEV."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.bev = TemporalCrossAttention(BEVAttention(config), config.channels)

    def forward(self, content: Tensor, queries: TemporalQueries, cache: LayerCache, window: Window) -> Tensor:
        """content (Q, C); returns the new content (Q, C)."""
        return self.bev(content, queries, cache.bev, window)


class PVOnlyAttention(nn.Module):
    """Paper, ablation of the spaces, "PV Only": attention in PV."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.pv = TemporalCrossAttention(PVAttention(config), config.channels)

    def forward(self, content: Tensor, queries: TemporalQueries, cache: LayerCache, window: Window) -> Tensor:
        """content (Q, C); returns the new content (Q, C)."""
        return self.pv(content, queries, cache.pv, window)


CROSS_ATTENTIONS = {
    "duo": DuoSpaceAttention,
    "shared_content": SharedContentAttention,
    "unshared": UnsharedAttention,
    "bev": BEVOnlyAttention,
    "pv": PVOnlyAttention,
}


class TemporalCrossAttention(nn.Module):
    """Cross-attention in one space: a query attends to every frame, and a recurrence aggregates the results.

    The residual connection and the norm are those of DETR.
    """

    def __init__(self, attention: BEVAttention | PVAttention, channels: int) -> None:
        super().__init__()
        self.attention = attention
        self.recurrence = TemporalRecurrence(channels)
        self.dropout = Dropout()
        self.norm = nn.LayerNorm(channels)

    def project_values(self, features: Any) -> Any:
        """Project the features of one frame, F_BEV or the levels of F_PV, to attention values."""
        return self.attention.project_values(features)

    def forward(self, content: Tensor, queries: TemporalQueries, frames: list, window: Window) -> Tensor:
        """Attend to the frames of a window.

        content (Q, C): the content embeddings for this space.
        frames: the attention values of this space, index 0 the newest frame. If there are fewer than in the window,
            only the newest frames are used.

        Returns (Q, C).
        """
        queries, window = queries.newest(len(frames)), window.newest(len(frames))
        attended = self.attention(content + queries.embeddings, queries.poses, frames, window)
        return self.norm(content + self.dropout(self.recurrence(attended, window.frame_valid)))


class TemporalRecurrence(nn.Module):
    """A recurrent 3-layer MLP: each frame updates the state, from the oldest frame to the newest.

    The initial state is zero. A masked frame does not change the state.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.mlp = nn.Sequential(
            nn.Linear(2 * channels, channels),
            nn.ReLU(inplace=True),
            nn.Linear(channels, channels),
            nn.ReLU(inplace=True),
            nn.Linear(channels, channels),
        )

    def forward(self, attended: Tensor, frame_valid: Tensor) -> Tensor:
        """Aggregate the attention results of the frames.

        attended (T, Q, C): index 0 is the newest frame.
        frame_valid (T) bool.

        Returns (Q, C).
        """
        state = torch.zeros_like(attended[0])
        for t in reversed(range(len(attended))):
            # `where` instead of a product with the mask, because NaN times 0 is NaN. An empty slot may hold NaN.
            state = torch.where(frame_valid[t], self.mlp(torch.cat((state, attended[t]), dim=-1)), state)
        return state
