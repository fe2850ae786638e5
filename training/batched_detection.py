"""Detection in several frames at once, with one call of the decoder."""

from collections.abc import Sequence

import torch
from torch import Tensor

from ..model import DuoSpaceNet
from ..model.decoder import FrameCache, Prediction
from ..model.window import Window

DecoderInputs = tuple[list[FrameCache], Window]


def detect_batch(model: DuoSpaceNet, inputs: Sequence[DecoderInputs]) -> list[list[Prediction]]:
    """The predictions of `model.detect` for several windows of equal length, from one call of the decoder.

    A GPU takes nearly the same time for the small operations of one window and of many. The model must have no dropout:
    the random numbers of a window would depend on the other windows.

    inputs: the cached values and the window of each sample.

    Returns the prediction of each layer, for each sample.
    """
    caches, windows = zip(*inputs, strict=True)
    predictions = torch.vmap(model.detect)(_stack_caches(caches), Window(*map(torch.stack, zip(*windows, strict=True))))
    return [
        [Prediction(layer.class_logits[sample], layer.pose[sample]) for layer in predictions]
        for sample in range(len(inputs))
    ]


def _stack_caches(samples: Sequence[list[FrameCache]]) -> list[FrameCache]:
    """One cache per frame of the window, whose values have the samples as their first axis."""
    return [
        FrameCache(
            [_stack_levels(levels) for levels in zip(*(frame.pv for frame in frames), strict=True)],
            _stack_levels([frame.bev for frame in frames]),
        )
        for frames in zip(*samples, strict=True)
    ]


def _stack_levels(samples: Sequence[list[Tensor]]) -> list[Tensor]:
    return [torch.stack(levels) for levels in zip(*samples, strict=True)]
