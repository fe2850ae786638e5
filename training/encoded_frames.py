"""Encoded frames: the frames of a clip with their features, and the decoder inputs that are computed from them."""

from typing import NamedTuple

import torch
from torch import Tensor

from ..model import DuoSpaceNet
from ..model.decoder import FrameCache
from ..model.duospacenet import FrameFeatures
from ..model.window import Window
from .samples.training_frames import TrainingFrame


class EncodedFrame(NamedTuple):
    """A training frame and its features."""

    frame: TrainingFrame
    features: FrameFeatures

    def detached(self) -> "EncodedFrame":
        """The same frame with features that are detached from the autograd graph."""
        pv, bev = self.features
        detached = FrameFeatures([level.detach() for level in pv], None if bev is None else bev.detach())
        return EncodedFrame(self.frame, detached)


def decoder_inputs(model: DuoSpaceNet, encoded: list[EncodedFrame]) -> tuple[list[FrameCache], Window]:
    """The attention values of each frame and the temporal window, as the decoder takes them.

    encoded: 1 to T frames of one clip, the newest first. The window has no empty slots, which would have no effect.

    The attention values of past frames are computed from their stored features with the current weights. Only the
    newest frame gives the projections a gradient, because gradients of past frames would double the cost.
    """
    with torch.no_grad():
        past = [model.cache_frame(past_frame.features) for past_frame in encoded[1:]]
    window = make_window([encoded_frame.frame for encoded_frame in encoded])
    return [model.cache_frame(encoded[0].features), *past], window


def make_window(frames: list[TrainingFrame]) -> Window:
    """The temporal window of these frames, the newest first."""
    now, device = frames[0], frames[0].images.device
    past_T_now = [torch.linalg.inv(past.global_T_ego) @ now.global_T_ego for past in frames]
    past_T_now[0] = torch.eye(4, dtype=torch.float64)  # the product above is the identity up to rounding only
    # Poses and times are subtracted in float64. In float32, Unix times have steps of 128 s and UTM coordinates of 3 cm.
    return Window(
        torch.stack([frame.image_T_ego for frame in frames]),
        _to_float32(past_T_now, device),
        _to_float32([now.timestamp_s - past.timestamp_s for past in frames], device),
        torch.ones(len(frames), dtype=torch.bool, device=device),
        torch.stack([frame.camera_valid for frame in frames]),
    )


def _to_float32(values: list[Tensor], device: torch.device) -> Tensor:
    return torch.stack(values).float().to(device)
