"""The past of a drive while it is trained on: features without a gradient, and where they were seen from."""

from typing import NamedTuple

import torch
from torch import Tensor

from ..model import DuoSpaceNet
from ..model.decoder import FrameMemory
from ..model.duospacenet import FrameFeatures
from ..model.window import Window
from .training_frames import Sample


class PastFeatures(NamedTuple):
    """A frame that has been looked at."""

    sample: Sample
    features: FrameFeatures

    def detached(self) -> "PastFeatures":
        """The same with features that no gradient goes back through."""
        pv, bev = self.features
        return PastFeatures(
            self.sample, FrameFeatures([level.detach() for level in pv], None if bev is None else bev.detach())
        )


def recall(model: DuoSpaceNet, moments: list[PastFeatures]) -> tuple[list[FrameMemory], Window]:
    """What the decoder takes, of 1 to T moments, the newest first. Empty slots would change nothing: there are none.

    Attention values are projected anew, with the weights of now, from the features that each frame had in its time;
    how to project is learned from the newest frame alone, for the past's would cost as much again.
    """
    with torch.no_grad():
        past = [model.remember(moment.features) for moment in moments[1:]]
    return [model.remember(moments[0].features), *past], make_window([moment.sample for moment in moments])


def make_window(samples: list[Sample]) -> Window:
    """The window of these samples, the newest first."""
    now, device = samples[0], samples[0].images.device
    past_T_now = [torch.linalg.inv(past.global_T_ego) @ now.global_T_ego for past in samples]
    past_T_now[0] = torch.eye(4, dtype=torch.float64)  # now is where it is, exactly
    return Window(
        torch.stack([sample.image_T_ego for sample in samples]),
        _float(past_T_now, device),
        _float([now.timestamp_s - past.timestamp_s for past in samples], device),
        torch.ones(len(samples), dtype=torch.bool, device=device),
        torch.stack([sample.camera_valid for sample in samples]),
    )


def _float(values: list[Tensor], device: torch.device) -> Tensor:
    return torch.stack(values).float().to(device)
