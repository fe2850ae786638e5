"""The duo space decoder, with its temporal queries (paper, "Duo Space Decoder" and "Temporal Modeling")."""

from typing import NamedTuple

from torch import Tensor, nn

from .attention import SelfAttention
from .bev_fusion import FUSIONS
from .config import DuoSpaceNetConfig
from .cross_attention import CROSS_ATTENTIONS, LayerCache
from .pose_vectors import compensate_motion
from .queries import PoseEncoder
from .window import TemporalQueries, Window


class FrameCache(NamedTuple):
    """What one frame leaves in memory; nothing of a space that no query looks into.

    pv[layer][j] (N, C, H_j, W_j): PV features as that layer's attention values. bev[layer] (1, C, X, Y): the same of
    BEV features; or bev[0] alone, the features themselves, where a fusion stands before the layers.
    """

    pv: list[list[Tensor]]
    bev: list[Tensor]


class Prediction(NamedTuple):
    """What a decoder layer predicts: class_logits (Q, classes), and refined poses (Q, 10)."""

    class_logits: Tensor
    pose: Tensor


class DuoSpaceDecoder(nn.Module):
    """Refines duo space queries layer by layer."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.config = config
        self.pose_encoder = PoseEncoder(config)
        self.bev_fusion = FUSIONS[config.bev_temporal](config) if config.fuses_bev else None
        self.layers = nn.ModuleList(DecoderLayer(config) for _ in range(config.num_layers))

    def cache_pv(self, pv: list[Tensor]) -> list[list[Tensor]]:
        """F_PV^j as `FrameMemory.pv`."""
        return [layer.cross_attention.pv.values(pv) for layer in self.layers] if self.config.attends_pv else []

    def cache_bev(self, bev: Tensor) -> list[Tensor]:
        """F_BEV as `FrameMemory.bev`."""
        if not self.config.attends_bev:
            return []
        return [bev] if self.bev_fusion is not None else self._bev_values(bev)

    def forward(self, content: Tensor, pose: Tensor, memory: list[FrameCache], window: Window) -> list[Prediction]:
        """content (Q, content channels), pose (Q, 10): the queries; memory: of the window's T frames.

        Returns every layer's prediction, the last one the best.
        """
        predictions = []
        for layer, values in zip(self.layers, self._recall(memory, window), strict=True):
            poses = compensate_motion(pose, window.past_T_now, window.time_delta_s)
            queries = TemporalQueries(poses, self.pose_encoder(poses))
            content, prediction = layer(content, queries, values, window)
            predictions.append(prediction)
            pose = prediction.pose
        return predictions

    def _recall(self, memory: list[FrameCache], window: Window) -> list[LayerCache]:
        """What the layers look at, frame by frame or fused to one."""
        bev = [frame.bev for frame in memory]
        if self.bev_fusion is not None:
            bev = [self._bev_values(self.bev_fusion([features for (features,) in bev], window))]
        pv_by_layer = _by_layer([frame.pv for frame in memory], len(self.layers))
        return [LayerCache(*spaces) for spaces in zip(pv_by_layer, _by_layer(bev, len(self.layers)), strict=True)]

    def _bev_values(self, bev: Tensor) -> list[Tensor]:
        return [layer.cross_attention.bev.values(bev) for layer in self.layers]


class DecoderLayer(nn.Module):
    """Self-attention, space-specific temporal cross-attention, feed-forward network, prediction.

    Residuals and norms stand where DETR has them.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        channels = config.content_channels
        self.num_contents = channels // config.channels
        self.self_attention = SelfAttention(channels, config.num_heads)
        self.self_attention_norm = nn.LayerNorm(channels)
        self.cross_attention = CROSS_ATTENTIONS[config.queries](config)
        self.feedforward = nn.Sequential(
            nn.Linear(channels, config.feedforward_channels),
            nn.ReLU(inplace=True),
            nn.Linear(config.feedforward_channels, channels),
        )
        self.feedforward_norm = nn.LayerNorm(channels)
        self.heads = PredictionHeads(config)

    def forward(
        self, content: Tensor, queries: TemporalQueries, memory: LayerCache, window: Window
    ) -> tuple[Tensor, Prediction]:
        """content (Q, content channels); returns the same, and what is predicted from it."""
        z = content + queries.embeddings[0].repeat(1, self.num_contents)  # eqs. 2-4
        content = self.self_attention_norm(content + self.self_attention(z))
        content = self.cross_attention(content, queries, memory, window)
        content = self.feedforward_norm(content + self.feedforward(content))
        return content, self.heads(content, queries.poses[0])


class PredictionHeads(nn.Module):
    """Category and refined pose vector of every query."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.classes = _head(config.content_channels, len(config.classes))
        self.refinement = _head(config.content_channels, 10)

    def forward(self, content: Tensor, pose: Tensor) -> Prediction:
        """content (Q, content channels), pose (Q, 10); the pose head predicts the difference to the layer's input."""
        return Prediction(self.classes(content), pose + self.refinement(content))


def _head(in_channels: int, out_channels: int) -> nn.Sequential:
    hidden = in_channels // 2
    return nn.Sequential(
        nn.Linear(in_channels, hidden),
        nn.ReLU(inplace=True),
        nn.LayerNorm(hidden),
        nn.Linear(hidden, out_channels),
    )


def _by_layer(frames: list[list], num_layers: int) -> list[list]:
    """[frame][layer] to [layer][frame]; where frames hold nothing, nothing for every layer."""
    return [list(values) for values in zip(*frames, strict=True)] or [[]] * num_layers
