"""The duo space decoder, with its temporal queries (paper, "Duo Space Decoder" and "Temporal Modeling")."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from .attention import BEVAttention, PVAttention, SelfAttention
from .config import DuoSpaceNetConfig
from .geometry import compensate_motion
from .queries import Content, PoseEncoder


class LayerValues(NamedTuple):
    """One frame's features as one decoder layer's attention values: pv[j] (N, C, H_j, W_j); bev (1, C, X, Y)."""

    pv: list[Tensor]
    bev: Tensor


FrameValues = list[LayerValues]  # what one frame leaves in memory, a decoder layer each


class Window(NamedTuple):
    """Where and when the frames of the temporal window were. Index 0 is now and always there, index t is t frames ago.

    image_T_ego (T, N, 3, 4) [px]: each frame's own calibration, from its own ego frame.
    past_T_now (T, 4, 4): from the current ego frame to that frame's. time_delta_s (T): how long ago.
    frame_valid (T) bool: a slot that holds no frame changes nothing, whatever lies in it.
    camera_valid (T, N) bool: False for a lost camera.
    """

    image_T_ego: Tensor
    past_T_now: Tensor
    time_delta_s: Tensor
    frame_valid: Tensor
    camera_valid: Tensor


class Prediction(NamedTuple):
    """What a decoder layer predicts: class_logits (Q, classes), and refined poses (Q, 10)."""

    class_logits: Tensor
    pose: Tensor


class DuoSpaceDecoder(nn.Module):
    """Refines duo space queries layer by layer."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        self.pose_encoder = PoseEncoder(config)
        self.layers = nn.ModuleList(DecoderLayer(config) for _ in range(config.num_layers))

    def pv_values(self, pv: list[Tensor]) -> list[list[Tensor]]:
        """F_PV^j to every layer's values, [layer][j]."""
        return [layer.pv_attention.values(pv) for layer in self.layers]

    def bev_values(self, bev: Tensor) -> list[Tensor]:
        """F_BEV to every layer's values, [layer]."""
        return [layer.bev_attention.values(bev) for layer in self.layers]

    def forward(self, content: Content, pose: Tensor, memory: list[FrameValues], window: Window) -> list[Prediction]:
        """content, pose (Q, 10): the queries; memory: the values of the window's T frames.

        Returns every layer's prediction, the last one the best.
        """
        predictions = []
        for index, layer in enumerate(self.layers):
            temporal_poses = compensate_motion(pose, window.past_T_now, window.time_delta_s)
            embeddings = self.pose_encoder(temporal_poses)
            values = [frame[index] for frame in memory]
            content, prediction = layer(content, temporal_poses, embeddings, values, window)
            predictions.append(prediction)
            pose = prediction.pose
        return predictions


class DecoderLayer(nn.Module):
    """Self-attention, space-specific temporal cross-attention, feed-forward network, prediction."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        channels, duo_channels = config.channels, 2 * config.channels
        self.self_attention = SelfAttention(duo_channels, config.num_heads)
        self.self_attention_norm = nn.LayerNorm(duo_channels)
        self.bev_attention = BEVAttention(config)
        self.bev_recurrence = TemporalRecurrence(channels)
        self.bev_norm = nn.LayerNorm(channels)
        self.pv_attention = PVAttention(config)
        self.pv_recurrence = TemporalRecurrence(channels)
        self.pv_norm = nn.LayerNorm(channels)
        self.feedforward = nn.Sequential(
            nn.Linear(duo_channels, config.feedforward_channels),
            nn.ReLU(inplace=True),
            nn.Linear(config.feedforward_channels, duo_channels),
        )
        self.feedforward_norm = nn.LayerNorm(duo_channels)
        self.heads = PredictionHeads(config)

    def forward(
        self,
        content: Content,
        poses: Tensor,
        embeddings: Tensor,
        values: list[LayerValues],
        window: Window,
    ) -> tuple[Content, Prediction]:
        """content: (Q, C) each; poses (T, Q, 10) and their embeddings (T, Q, C), index 0 now; values: T frames.

        Residuals and norms stand where DETR has them.
        """
        duo = torch.cat(content, dim=-1)
        z = duo + embeddings[0].repeat(1, 2)  # eqs. 2-4
        content = Content(*self.self_attention_norm(duo + self.self_attention(z)).chunk(2, dim=-1))
        bev, pv = self.attend_in_time(content, poses, embeddings, values, window)
        duo = torch.cat((self.bev_norm(content.bev + bev), self.pv_norm(content.pv + pv)), dim=-1)
        duo = self.feedforward_norm(duo + self.feedforward(duo))
        return Content(*duo.chunk(2, dim=-1)), self.heads(duo, poses[0])

    def attend_in_time(
        self,
        content: Content,
        poses: Tensor,
        embeddings: Tensor,
        values: list[LayerValues],
        window: Window,
    ) -> Content:
        """Temporal duo space queries, the content of now with the pose of then, each attending to its own frame;
        aggregated from the oldest frame to the newest.
        """
        bev = self.bev_attention(content.bev + embeddings, poses, [frame.bev for frame in values])
        pv = self.pv_attention(
            content.pv + embeddings, poses, [frame.pv for frame in values], window.image_T_ego, window.camera_valid
        )
        return Content(self.bev_recurrence(bev, window.frame_valid), self.pv_recurrence(pv, window.frame_valid))


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


class PredictionHeads(nn.Module):
    """Category and refined pose vector of every query."""

    def __init__(self, config: DuoSpaceNetConfig) -> None:
        super().__init__()
        channels = 2 * config.channels
        self.classes = _head(channels, len(config.classes))
        self.refinement = _head(channels, 10)

    def forward(self, content: Tensor, pose: Tensor) -> Prediction:
        """content (Q, 2C), pose (Q, 10); the pose head predicts the difference to the layer's input pose."""
        return Prediction(self.classes(content), pose + self.refinement(content))


def _head(in_channels: int, out_channels: int) -> nn.Sequential:
    hidden = in_channels // 2
    return nn.Sequential(
        nn.Linear(in_channels, hidden),
        nn.ReLU(inplace=True),
        nn.LayerNorm(hidden),
        nn.Linear(hidden, out_channels),
    )
