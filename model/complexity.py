"""Number of parameters and floating-point operations (FLOPs) of each part of a DuoSpaceNet.

The model runs on the meta device, which computes only shapes.
There are two counts of FLOPs. The paper's count has two operations for each multiply-add of a convolution, linear layer
or matrix product. Of a deformable convolution it includes only the convolution that predicts offsets and masks.
The count with sampling adds the kernels of deformable convolutions and all bilinear sampling, with 4 multiply-adds per
sampled number. Neither count includes element-wise operations: normalisation, activation, softmax, weighting.
"""

from math import prod
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from .config import DuoSpaceNetConfig
from .duospacenet import DuoSpaceNet

# The model's attributes of each part. A configuration may lack some of them.
PARTS = {
    "encoder": ("image_encoder",),
    "lifter": ("projector", "lifter"),
    "FDE": ("divergence_enhancement",),
    "decoder": ("queries", "decoder"),
    "segmentation": ("segmentation",),
}
OPERATIONS_PER_SAMPLE = 2 * 4  # a sampled number is a weighted sum of four numbers

Shape = tuple[int, ...]


class Complexity(NamedTuple):
    """The size of one part, or of the whole model.

    parameters: number of parameters, without the running statistics of BatchNorm.
    flops: the paper's count.
    flops_with_sampling: the count with deformable kernels and bilinear sampling.
    """

    parameters: int
    flops: int
    flops_with_sampling: int


class Flops(NamedTuple):
    """Floating-point operations: the paper's count, and the count with sampling."""

    by_paper: int
    with_sampling: int


def complexity_by_part(config: DuoSpaceNetConfig, num_frames: int = 1) -> dict[str, Complexity]:
    """The complexity of each part of a DuoSpaceNet, by name, and of the whole model as "total".

    num_frames: frames of the window. All of them are encoded.

    A part that `config` does not have is not in the result.
    """
    with torch.device("meta"):
        model = DuoSpaceNet(config).eval()
        window = _forward_arguments(config, num_frames)
    parts = {name: _existing_modules(model, attributes) for name, attributes in PARTS.items()}
    flops = count_flops(model, window, parts)
    return {
        name: Complexity(count_parameters(modules), *flops[name])
        for name, modules in (parts | {"total": [model]}).items()
        if modules
    }


def count_parameters(modules: list[nn.Module]) -> int:
    """The number of parameters of the modules."""
    return sum(parameter.numel() for module in modules for parameter in module.parameters())


@torch.no_grad()
def count_flops(model: nn.Module, arguments: tuple[Tensor, ...], parts: dict[str, list[nn.Module]]) -> dict[str, Flops]:
    """The operations of `model(*arguments)` inside the modules of each part, and in the whole model as "total"."""
    with FlopCounterMode(display=False, custom_mapping=_SAMPLING) as counter:
        meters = {name: _PartMeter(counter, modules) for name, modules in parts.items()}
        model(*arguments)
        for meter in meters.values():
            meter.remove()
        return {name: meter.flops for name, meter in meters.items()} | {"total": _counted_flops(counter)}


class _PartMeter:
    """Counts the operations inside some modules. A call inside another call is counted once.

    All inner modules have hooks, because parts are also called by their methods: `decoder.cache_pv` runs inner modules
    without a call of the decoder itself.
    """

    def __init__(self, counter: FlopCounterMode, modules: list[nn.Module]) -> None:
        self.flops = Flops(0, 0)
        self.counter = counter
        self.starts: list[Flops] = []  # the counts at the start of each call that has not ended
        within = {inner for module in modules for inner in module.modules()}
        self.hooks = [module.register_forward_pre_hook(self.enter) for module in within]
        self.hooks += [module.register_forward_hook(self.leave) for module in within]

    def enter(self, *_: object) -> None:
        self.starts.append(_counted_flops(self.counter))

    def leave(self, *_: object) -> None:
        before, now = self.starts.pop(), _counted_flops(self.counter)
        if not self.starts:
            by_paper, with_sampling = self.flops
            self.flops = Flops(by_paper + now[0] - before[0], with_sampling + now[1] - before[1])

    def remove(self) -> None:
        for hook in self.hooks:
            hook.remove()


def _counted_flops(counter: FlopCounterMode) -> Flops:
    counts = counter.get_flop_counts().get("Global", {})
    return Flops(sum(count for op, count in counts.items() if op not in _SAMPLING), sum(counts.values()))


def _sampling_flops(*_: Shape, out_shape: Shape, **__: object) -> int:
    return OPERATIONS_PER_SAMPLE * prod(out_shape)


def _deformable_sampling_flops(
    values: list[Shape],
    locations: Shape,
    visible: Shape,
    offsets: Shape | None,
    weights: Shape | None,
    *_: int,
    out_shape: Shape,
) -> int:
    """Each channel of a query samples all cameras, at each point of each level."""
    num_frames, num_cameras, _ = visible
    num_levels, num_points = len(values) // num_frames, 1 if offsets is None else offsets[3]
    return OPERATIONS_PER_SAMPLE * prod(out_shape) * num_cameras * num_levels * num_points


def _deformable_convolution_flops(x: Shape, weight: Shape, *_: Shape, out_shape: Shape) -> int:
    """Each output position samples all input channels at each point of the kernel, and multiplies them."""
    positions, kernel = out_shape[0] * prod(out_shape[2:]), prod(weight[1:])
    return OPERATIONS_PER_SAMPLE * positions * kernel + 2 * positions * prod(weight)


_SAMPLING = {
    torch.ops.aten.grid_sampler_2d: _sampling_flops,
    torch.ops.duospacenet.deformable_sampling: _deformable_sampling_flops,
    torch.ops.duospacenet.deformable_convolution: _deformable_convolution_flops,
}


def _existing_modules(model: nn.Module, attributes: tuple[str, ...]) -> list[nn.Module]:
    modules = (getattr(model, attribute, None) for attribute in attributes)
    return [module for module in modules if module is not None]


def _forward_arguments(config: DuoSpaceNetConfig, num_frames: int) -> tuple[Tensor, ...]:
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
