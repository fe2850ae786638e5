"""Space-specific temporal cross-attention, and the ways in which queries can look into two spaces."""

from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from .attention import BEVAttention, PVAttention
from .config import DuoSpaceNetConfig
from .window import TemporalQueries, Window


class LayerCache(NamedTuple):
    """A window's features as one decoder layer's attention values, the newest frame first.

    pv[t][j] (N, C, H_j, W_j); bev[t] (1, C, X, Y), of one frame alone where that one holds the past of the others.
    """

    pv: list[list[Tensor]]
    bev: list[Tensor]


class DuoSpaceAttention(nn.Module):
    """The paper's: every query has a content embedding for each space, BEV ⊕ PV along the channels."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.bev = TemporalCrossAttention(BEVAttention(config), config.channels)
        self.pv = TemporalCrossAttention(PVAttention(config), config.channels)

    def forward(self, content: Tensor, queries: TemporalQueries, memory: LayerCache, window: Window) -> Tensor:
        """content (Q, 2C); returns the same."""
        bev, pv = content.chunk(2, dim=-1)
        return torch.cat((self.bev(bev, queries, memory.bev, window), self.pv(pv, queries, memory.pv, window)), dim=-1)


class SharedContentAttention(nn.Module):
    """Paper, ablation of the queries, "shared pose and shared content": into PV, then into BEV."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.pv = TemporalCrossAttention(PVAttention(config), config.channels)
        self.bev = TemporalCrossAttention(BEVAttention(config), config.channels)

    def forward(self, content: Tensor, queries: TemporalQueries, memory: LayerCache, window: Window) -> Tensor:
        """content (Q, C); returns the same."""
        return self.bev(self.pv(content, queries, memory.pv, window), queries, memory.bev, window)


class UnsharedAttention(nn.Module):
    """Paper, ablation of the queries, "unshared pose and unshared content": two sets of queries, a space each.

    The first half of the queries looks into BEV, the second into PV.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.bev = TemporalCrossAttention(BEVAttention(config), config.channels)
        self.pv = TemporalCrossAttention(PVAttention(config), config.channels)

    def forward(self, content: Tensor, queries: TemporalQueries, memory: LayerCache, window: Window) -> Tensor:
        """content (Q, C); returns the same."""
        (bev, pv), (bev_queries, pv_queries) = content.chunk(2), queries.halves()
        return torch.cat((self.bev(bev, bev_queries, memory.bev, window), self.pv(pv, pv_queries, memory.pv, window)))


class BEVOnlyAttention(nn.Module):
    """Paper, ablation of the spaces, "BEV Only"."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.bev = TemporalCrossAttention(BEVAttention(config), config.channels)

    def forward(self, content: Tensor, queries: TemporalQueries, memory: LayerCache, window: Window) -> Tensor:
        """content (Q, C); returns the same."""
        return self.bev(content, queries, memory.bev, window)


class PVOnlyAttention(nn.Module):
    """Paper, ablation of the spaces, "PV Only"."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.pv = TemporalCrossAttention(PVAttention(config), config.channels)

    def forward(self, content: Tensor, queries: TemporalQueries, memory: LayerCache, window: Window) -> Tensor:
        """content (Q, C); returns the same."""
        return self.pv(content, queries, memory.pv, window)


CROSS_ATTENTIONS = {
    "duo": DuoSpaceAttention,
    "shared_content": SharedContentAttention,
    "unshared": UnsharedAttention,
    "bev": BEVOnlyAttention,
    "pv": PVOnlyAttention,
}


class TemporalCrossAttention(nn.Module):
    """Temporal queries in one space: each attends to its own frame; aggregated from the oldest frame to the newest.

    Residual and norm stand where DETR has them.
    """

    def __init__(self, attention: BEVAttention | PVAttention, channels: int) -> None:
        super().__init__()
        self.attention = attention
        self.recurrence = TemporalRecurrence(channels)
        self.norm = nn.LayerNorm(channels)

    def values(self, features: Any) -> Any:
        """One frame's features of this space to the values that are looked at."""
        return self.attention.values(features)

    def forward(self, content: Tensor, queries: TemporalQueries, frames: list, window: Window) -> Tensor:
        """content (Q, C), of now; frames: this space's values of as many frames as are looked at, the newest first."""
        queries, window = queries.newest(len(frames)), window.newest(len(frames))
        attended = self.attention(content + queries.embeddings, queries.poses, frames, window)
        return self.norm(content + self.recurrence(attended, window.frame_valid))


class TemporalRecurrence(nn.Module):
    """A 3-layer MLP that takes up one frame after the other, oldest first, with the same weights.

    The recurrence starts from zeros. A masked frame passes the state on by selection, so that not even a NaN
    in it comes through.
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
        """attended (T, Q, C), index 0 the newest; frame_valid (T) bool. Returns (Q, C)."""
        state = torch.zeros_like(attended[0])
        for t in reversed(range(len(attended))):
            state = torch.where(frame_valid[t], self.mlp(torch.cat((state, attended[t]), dim=-1)), state)
        return state
