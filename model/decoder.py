"""The duo space decoder with temporal queries (paper, "Duo Space Decoder" and "Temporal Modeling")."""

from typing import NamedTuple

from torch import Tensor, nn

from .attention import SelfAttention
from .bev_fusion import FUSIONS
from .config import DuoSpaceNetConfig
from .cross_attention import CROSS_ATTENTIONS, LayerCache
from .dropout import Dropout
from .pose_vectors import compensate_motion
from .queries import PoseEncoder
from .window import TemporalQueries, Window


class FrameCache(NamedTuple):
    """The cached values of one frame. The list of a space, PV or BEV, is empty if no query attends to that space.

    pv[layer][j] (N, C, H_j, W_j): the PV attention values of each layer.
    bev[layer] (1, C, X, Y): the BEV attention values of each layer. With a BEV fusion, only bev[0]: the BEV features.
    """

    pv: list[list[Tensor]]
    bev: list[Tensor]


class Prediction(NamedTuple):
    """The prediction of one decoder layer: class_logits (Q, classes) and refined pose vectors (Q, 10)."""

    class_logits: Tensor
    pose: Tensor


class DuoSpaceDecoder(nn.Module):
    """The decoder layers, which refine the duo space queries one after the other."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.config = config
        self.pose_encoder = PoseEncoder(config)
        self.bev_fusion = FUSIONS[config.bev_temporal](config) if config.fuses_bev else None
        self.layers = nn.ModuleList(DecoderLayer(config) for _ in range(config.num_layers))

    def cache_pv(self, pv: list[Tensor]) -> list[list[Tensor]]:
        """Convert F_PV^j (N, C, H_j, W_j) of a frame to `FrameCache.pv`."""
        return [layer.cross_attention.pv.project_values(pv) for layer in self.layers] if self.config.attends_pv else []

    def cache_bev(self, bev: Tensor) -> list[Tensor]:
        """Convert F_BEV (1, C, X, Y) of a frame to `FrameCache.bev`."""
        if not self.config.attends_bev:
            return []
        return [bev] if self.bev_fusion is not None else self._bev_values(bev)

    def forward(self, content: Tensor, pose: Tensor, caches: list[FrameCache], window: Window) -> list[Prediction]:
        """Detect objects in a window.

        content (Q, content channels), pose (Q, 10): the queries.
        caches: the cached values of the T frames, index 0 the current frame.

        Returns the prediction of each layer. The last one is the final prediction.
        """
        predictions = []
        for layer, values in zip(self.layers, self._layer_caches(caches, window), strict=True):
            # Again in every layer: each layer refines the pose, so the positions in past frames change too.
            poses = compensate_motion(pose, window.past_T_now, window.time_delta_s)
            queries = TemporalQueries(poses, self.pose_encoder(poses))
            content, prediction = layer(content, queries, values, window)
            predictions.append(prediction)
            pose = prediction.pose
        return predictions

    def _layer_caches(self, caches: list[FrameCache], window: Window) -> list[LayerCache]:
        """Regroup the cached values by layer instead of by frame, after the BEV fusion if there is one."""
        bev = [frame.bev for frame in caches]
        if self.bev_fusion is not None:
            # The fused features depend on the whole window, so their attention values cannot be cached per frame.
            bev = [self._bev_values(self.bev_fusion([features for (features,) in bev], window))]
        pv_by_layer = _by_layer([frame.pv for frame in caches], len(self.layers))
        return [LayerCache(*spaces) for spaces in zip(pv_by_layer, _by_layer(bev, len(self.layers)), strict=True)]

    def _bev_values(self, bev: Tensor) -> list[Tensor]:
        return [layer.cross_attention.bev.project_values(bev) for layer in self.layers]


class DecoderLayer(nn.Module):
    """Self-attention, space-specific temporal cross-attention, feed-forward network and prediction heads.

    The residual connections, norms and dropouts are those of DETR. The rate of all dropouts is 0; training may set
    another.
    """

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        channels = config.content_channels
        self.num_contents = channels // config.channels
        self.self_attention = SelfAttention(channels, config.num_heads)
        self.self_attention_dropout = Dropout()
        self.self_attention_norm = nn.LayerNorm(channels)
        self.cross_attention = CROSS_ATTENTIONS[config.queries](config)
        self.feedforward = nn.Sequential(
            nn.Linear(channels, config.feedforward_channels),
            nn.Sequential(nn.ReLU(inplace=True), Dropout()),
            nn.Linear(config.feedforward_channels, channels),
        )
        self.feedforward_dropout = Dropout()
        self.feedforward_norm = nn.LayerNorm(channels)
        self.heads = PredictionHeads(config)

    def forward(
        self, content: Tensor, queries: TemporalQueries, cache: LayerCache, window: Window
    ) -> tuple[Tensor, Prediction]:
        """Update the content of the queries, and predict from it.

        content (Q, content channels).
        queries: the poses of the queries in the ego frame of each frame. Index 0 is refined.
        cache: the attention values of this layer.

        Returns the new content (Q, content channels) and the prediction.
        """
        content = self.attend_to_queries(content, queries.embeddings[0])
        content = self.cross_attention(content, queries, cache, window)
        content = self.feedforward_norm(content + self.feedforward_dropout(self.feedforward(content)))
        return content, self.heads(content, queries.poses[0])

    def attend_to_queries(self, content: Tensor, embedding: Tensor) -> Tensor:
        """Self-attention (eqs. 2-4). content (Q, content channels), embedding Q_Pose (Q, C); returns new content."""
        z = content + embedding.repeat(1, self.num_contents)
        return self.self_attention_norm(content + self.self_attention_dropout(self.self_attention(z)))


class PredictionHeads(nn.Module):
    """The heads for the class logits and the refined pose vector of each query."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.classes = _head(config.content_channels, len(config.classes))
        self.refinement = _head(config.content_channels, 10)

    def forward(self, content: Tensor, pose: Tensor) -> Prediction:
        """Predict from content (Q, content channels). The refinement is added to pose (Q, 10)."""
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
    """Convert [frame][layer] to [layer][frame]. If the frames are empty, each layer gets an empty list."""
    return [list(values) for values in zip(*frames, strict=True)] or [[]] * num_layers
