"""Models before and after a rewrite: their outputs on a window, and the operators that they call."""

import copy
import functools
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from duospacenet.model import PRESETS, DuoSpaceNet, DuoSpaceNetConfig, randomise
from duospacenet.model.config import VoxelGrid
from duospacenet.model.presets import ABLATIONS
from duospacenet.model.window import Window
from tests.helpers import vovnets
from tests.helpers.model_inputs import random_images, random_window

NUM_FRAMES = 3

_TINY = PRESETS["tiny"]
CONFIGS: dict[str, DuoSpaceNetConfig] = {
    "tiny": _TINY,
    **{name: PRESETS[f"tiny-{name}"] for name in ABLATIONS},
    "bgr": replace(_TINY, image=replace(_TINY.image, colour_order="bgr", mean=(90.0, 110.0, 130.0))),
    "one height": replace(_TINY, voxels=VoxelGrid((16, 12, 1))),
    "two heights": replace(_TINY, voxels=VoxelGrid((12, 16, 2))),
    "three heights": replace(_TINY, voxels=VoxelGrid((12, 16, 3))),
    "one layer": replace(_TINY, num_layers=1),
    "three layers": replace(_TINY, num_layers=3),
    "VoVNet": vovnets.TINY,
}


@functools.cache
def model_of(name: str) -> DuoSpaceNet:
    """A model with random weights and the configuration `name`. Tests that change it make a copy."""
    return randomise(DuoSpaceNet(CONFIGS[name]), 1).eval().requires_grad_(False)


@functools.cache
def outputs_of(name: str) -> dict[str, Tensor]:
    """The outputs of `model_of(name)`."""
    return outputs(model_of(name))


def rewritten_by(rewrite: Callable[[DuoSpaceNet], None], name: str) -> DuoSpaceNet:
    """A copy of `model_of(name)` after one rewrite."""
    model = copy.deepcopy(model_of(name))
    rewrite(model)
    return model


def inputs(config: DuoSpaceNetConfig) -> tuple[Tensor, Window]:
    """Images and a window of three frames. The oldest is masked, and two cameras are lost."""
    window = random_window(config, NUM_FRAMES, seed=2)
    window.frame_valid[2] = window.camera_valid[0, 1] = window.camera_valid[1, 4] = False
    return random_images(config, NUM_FRAMES, seed=2), window


@torch.no_grad()
def outputs(model: DuoSpaceNet) -> dict[str, Tensor]:
    """The predictions of every layer and the maps, by name."""
    images, window = inputs(model.config)
    predictions, maps = model(images, *window)
    return {
        **{f"class logits {layer}": prediction.class_logits for layer, prediction in enumerate(predictions)},
        **{f"pose {layer}": prediction.pose for layer, prediction in enumerate(predictions)},
        **maps,
    }


def called_operators(model: DuoSpaceNet) -> Counter[str]:
    """How often the model calls each torch operator, such as `aten.addmm.default`, for the same inputs."""
    with _OperatorCounter() as counter:
        outputs(model)
    return counter.calls


class _OperatorCounter(TorchDispatchMode):
    def __init__(self) -> None:
        super().__init__()
        self.calls: Counter[str] = Counter()

    def __torch_dispatch__(self, operator, types, args=(), kwargs=None):  # type: ignore[no-untyped-def]
        self.calls[str(operator)] += 1
        return operator(*args, **(kwargs or {}))
