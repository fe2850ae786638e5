"""VoVNetV2 (Lee & Park, 2020) with the published weights' state-dict names, so that V2-99 of DD3D or FCOS3D loads."""

from collections import OrderedDict
from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..config import VoVNetConfig


class VoVNet(nn.Module):
    """Images to the features C3, C4, C5 at strides 8, 16 and 32.

    Names, strides and pooling are those of youngwanLEE/vovnet-detectron2, which DD3D and PETR's VoVNetCP took over.
    """

    def __init__(self, config: VoVNetConfig) -> None:
        super().__init__()
        self.stem = _stem(config)
        inputs = [config.stem[-1], *config.out_channels[:-1]]
        stages = [_stage(index, channels, config) for index, channels in enumerate(inputs)]
        self.stage2, self.stage3, self.stage4, self.stage5 = stages
        self.out_channels = list(config.out_channels[1:])

    def forward(self, images: Tensor) -> list[Tensor]:
        """images (N, 3, H, W), normalised; returns C3, C4, C5, each (N, out_channels[i], H_i, W_i).

        From stage to stage a size is halved; an odd one is rounded down, where ResNet rounds up, and one of 1 raises
        RuntimeError.
        """
        c2 = self.stage2(self.stem(images))
        c3 = self.stage3(c2)
        c4 = self.stage4(c3)
        return [c3, c4, self.stage5(c4)]


class OneShotAggregation(nn.Module):
    """An OSA module: convolutions in a row, all of whose outputs, and the input, are aggregated at once.

    `name` is part of the names inside, as in the published weights. identity: whether the input is added at the end.
    """

    def __init__(
        self, name: str, in_channels: int, width: int, out_channels: int, identity: bool, config: VoVNetConfig
    ) -> None:
        super().__init__()
        eps, depth = config.batch_norm_eps, config.num_convolutions
        inputs = [in_channels] + [width] * (depth - 1)
        self.layers = nn.ModuleList(
            _named(_convolution(f"{name}_{i}", channels, width, 3, 1, eps)) for i, channels in enumerate(inputs)
        )
        self.concat = _named(_convolution(f"{name}_concat", in_channels + depth * width, out_channels, 1, 1, eps))
        self.ese = EffectiveSqueezeExcitation(out_channels)
        self.identity = identity

    def forward(self, x: Tensor) -> Tensor:
        """x (N, in_channels, H, W); returns (N, out_channels, H, W)."""
        features = [x]
        for layer in self.layers:
            features.append(layer(features[-1]))
        aggregated = self.ese(self.concat(torch.cat(features, dim=1)))
        return aggregated + x if self.identity else aggregated


class EffectiveSqueezeExcitation(nn.Module):
    """eSE: every channel is weighted by what the averages of all channels say, X · σ(W_C F_gap(X)) in the paper.

    σ is the hard sigmoid of the published code, with which the weights were trained.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.fc = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """x (N, C, H, W); returns the same shape. A hard sigmoid is min(max(a + 3, 0), 6) / 6."""
        # Rows first: onnxruntime adds up one number after the other, and over a whole map of a lost camera, which is
        # the same everywhere, the rounding errors of float32 have one sign: 1e-4 over 160x400 cells.
        means = x.mean(dim=3, keepdim=True).mean(dim=2, keepdim=True)
        return x * F.hardsigmoid(self.fc(means))


def _stem(config: VoVNetConfig) -> nn.Sequential:
    """Three convolutions to stride 4."""
    inputs = [3, *config.stem[:-1]]
    modules: list[tuple[str, nn.Module]] = []
    for i, stride in enumerate((2, 1, 2)):
        modules += _convolution(f"stem_{i + 1}", inputs[i], config.stem[i], 3, stride, config.batch_norm_eps)
    return _named(modules)


def _stage(index: int, in_channels: int, config: VoVNetConfig) -> nn.Sequential:
    """Pooling, in all but the first stage, and OSA modules, all but the first of them with an identity mapping."""
    out_channels = config.out_channels[index]
    modules: list[tuple[str, nn.Module]] = []
    if index > 0:
        modules.append(("Pooling", nn.MaxPool2d(3, stride=2, ceil_mode=True)))
    for i in range(config.depths[index]):
        name, channels = f"OSA{index + 2}_{i + 1}", in_channels if i == 0 else out_channels
        modules.append((name, OneShotAggregation(name, channels, config.widths[index], out_channels, i > 0, config)))
    return _named(modules)


def _convolution(
    name: str, in_channels: int, out_channels: int, size: int, stride: int, eps: float
) -> Iterator[tuple[str, nn.Module]]:
    """Convolution, BatchNorm and ReLU, by their names."""
    convolution = nn.Conv2d(in_channels, out_channels, size, stride=stride, padding=size // 2, bias=False)
    yield f"{name}/conv", convolution
    yield f"{name}/norm", nn.BatchNorm2d(out_channels, eps=eps)
    yield f"{name}/relu", nn.ReLU(inplace=True)


def _named(modules: Iterator[tuple[str, nn.Module]] | list[tuple[str, nn.Module]]) -> nn.Sequential:
    return nn.Sequential(OrderedDict(modules))
