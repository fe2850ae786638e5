"""How large a DuoSpaceNet is: parameters and floating-point operations by part, counted on the meta device.

Two rules. The paper's: two operations for each multiply-add of a convolution, linear layer or matrix product, where a
deformable convolution's kernel is not seen, its offset convolution is. And with sampling: the deformable kernels as
well, and bilinear sampling, there and in attention and lifting, as 4 multiply-adds for each number sampled. Neither
counts what is done number by number: normalisation, activation, softmax, the weighing of samples.
"""

from math import prod
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from .config import DuoSpaceNetConfig
from .duospacenet import DuoSpaceNet

# A part is some of the model's own; those of them that a configuration does not have are None.
PARTS = {
    "encoder": ("image_encoder",),
    "lifter": ("projector", "lifter"),
    "FDE": ("divergence_enhancement",),
    "decoder": ("queries", "decoder"),
    "segmentation": ("segmentation",),
}
OPERATIONS_PER_SAMPLE = 2 * 4  # a number that is sampled is a weighted sum of four

Shape = tuple[int, ...]


class Complexity(NamedTuple):
    """parameters: what training changes, without the running statistics of BatchNorm. flops: by the paper's rule.
    flops_with_sampling: with deformable kernels and bilinear sampling as well.
    """

    parameters: int
    flops: int
    flops_with_sampling: int


class Flops(NamedTuple):
    """Floating-point operations by the paper's rule, and with sampling."""

    by_paper: int
    with_sampling: int


def complexity_by_part(config: DuoSpaceNetConfig, num_frames: int = 1) -> dict[str, Complexity]:
    """The complexity of a DuoSpaceNet on a window of `num_frames` frames, each of them encoded: by part, and in total.

    Parts that the configuration does not have are left out.
    """
    with torch.device("meta"):
        model = DuoSpaceNet(config).eval()
        window = _window(config, num_frames)
    parts = {name: _present(model, words) for name, words in PARTS.items()}
    flops = count_flops(model, window, parts)
    return {
        name: Complexity(count_parameters(modules), *flops[name])
        for name, modules in (parts | {"total": [model]}).items()
        if modules
    }


def count_parameters(modules: list[nn.Module]) -> int:
    """Numbers that training changes."""
    return sum(parameter.numel() for module in modules for parameter in module.parameters())


@torch.no_grad()
def count_flops(model: nn.Module, arguments: tuple[Tensor, ...], parts: dict[str, list[nn.Module]]) -> dict[str, Flops]:
    """The operations of `model(*arguments)`, those within the modules of each part, and the "total"."""
    with FlopCounterMode(display=False, custom_mapping=_SAMPLING) as counter:
        meters = {name: _Meter(counter, modules) for name, modules in parts.items()}
        model(*arguments)
        for meter in meters.values():
            meter.remove()
        return {name: meter.spent for name, meter in meters.items()} | {"total": _so_far(counter)}


class _Meter:
    """What is spent between entering and leaving some modules, or any module within them."""

    def __init__(self, counter: FlopCounterMode, modules: list[nn.Module]) -> None:
        self.spent = Flops(0, 0)
        self.counter = counter
        self.entered: list[Flops] = []  # what had been spent, by module that was entered and is not yet left
        within = {inner for module in modules for inner in module.modules()}
        self.hooks = [module.register_forward_pre_hook(self.enter) for module in within]
        self.hooks += [module.register_forward_hook(self.leave) for module in within]

    def enter(self, *_: object) -> None:
        self.entered.append(_so_far(self.counter))

    def leave(self, *_: object) -> None:
        before, now = self.entered.pop(), _so_far(self.counter)
        if not self.entered:
            by_paper, with_sampling = self.spent
            self.spent = Flops(by_paper + now[0] - before[0], with_sampling + now[1] - before[1])

    def remove(self) -> None:
        for hook in self.hooks:
            hook.remove()


def _so_far(counter: FlopCounterMode) -> Flops:
    counts = counter.get_flop_counts().get("Global", {})
    return Flops(sum(count for op, count in counts.items() if op not in _SAMPLING), sum(counts.values()))


def _sampling_flops(*_: Shape, out_shape: Shape, **__: object) -> int:
    return OPERATIONS_PER_SAMPLE * prod(out_shape)


def _deformable_flops(x: Shape, weight: Shape, *_: Shape, out_shape: Shape) -> int:
    """Every output place samples all input channels at each point of the kernel, and multiplies."""
    places, kernel = out_shape[0] * prod(out_shape[2:]), prod(weight[1:])
    return OPERATIONS_PER_SAMPLE * places * kernel + 2 * places * prod(weight)


_SAMPLING = {
    torch.ops.aten.grid_sampler_2d: _sampling_flops,
    torch.ops.duospacenet.deformable_convolution: _deformable_flops,
}


def _present(model: nn.Module, words: tuple[str, ...]) -> list[nn.Module]:
    modules = (getattr(model, word, None) for word in words)
    return [module for module in modules if module is not None]


def _window(config: DuoSpaceNetConfig, num_frames: int) -> tuple[Tensor, ...]:
    """The arguments of `DuoSpaceNet.forward`."""
    cameras = (num_frames, config.num_cameras)
    return (
        torch.zeros(*cameras, config.image.height_px, config.image.width_px, 3, dtype=torch.uint8),
        torch.zeros(*cameras, 3, 4),
        torch.zeros(num_frames, 4, 4),
        torch.zeros(num_frames),
        torch.ones(num_frames, dtype=torch.bool),
        torch.ones(cameras, dtype=torch.bool),
    )
