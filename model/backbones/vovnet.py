"""VoVNetV2 (Lee & Park, 2020). The state dict has the published names, to load the V2-99 weights of DD3D or FCOS3D."""

from collections import OrderedDict
from collections.abc import Iterator

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..config import VoVNetConfig


class VoVNet(nn.Module):
    """Computes the features C3, C4, C5 of images, at strides 8, 16 and 32.

    Names, strides and pooling are those of youngwanLEE/vovnet-detectron2, which DD3D and PETR (VoVNetCP) also use.
    """

    def __init__(self, config: VoVNetConfig) -> None:
        super().__init__()
        self.stem = _stem(config)
        inputs = [config.stem[-1], *config.out_channels[:-1]]
        stages = [_stage(index, channels, config) for index, channels in enumerate(inputs)]
        self.stage2, self.stage3, self.stage4, self.stage5 = stages
        self.out_channels = list(config.out_channels[1:])

    def forward(self, images: Tensor) -> list[Tensor]:
        """Convert normalised images (N, 3, H, W) to C3, C4, C5 (N, out_channels[i], H_i, W_i).

        Each stage halves the size. Odd sizes are rounded down, unlike in ResNet. Raises RuntimeError if an image is so
        small that a height or width before a pooling is 1.
        """
        c2 = self.stage2(self.stem(images))
        c3 = self.stage3(c2)
        c4 = self.stage4(c3)
        return [c3, c4, self.stage5(c4)]


class OneShotAggregation(nn.Module):
    """An OSA module: a sequence of convolutions, then an aggregation of the input and of all their outputs.

    name: part of the names of the layers, as in the published weights.
    identity: add the input to the result.
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
        """Convert x (N, in_channels, H, W) to (N, out_channels, H, W)."""
        features = [x]
        for layer in self.layers:
            features.append(layer(features[-1]))
        aggregated = self.ese(self.concat(torch.cat(features, dim=1)))
        return aggregated + x if self.identity else aggregated


class EffectiveSqueezeExcitation(nn.Module):
    """eSE: each channel is multiplied by a gate that depends on the means of all channels, X · σ(W_C F_gap(X)).

    σ is the hard sigmoid of the published code, min(max(a + 3, 0), 6) / 6, which the weights were trained with.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.fc = nn.Conv2d(channels, channels, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Apply the gates to x (N, C, H, W)."""
        # The mean of row means instead of one mean over the map. onnxruntime (1.31) adds float32 numbers one after the
        # other. On the constant map of a lost camera all rounding errors have the same sign. Over 160×400 cells they
        # would add up to a relative error of 1e-4, which fails the parity check.
        means = x.mean(dim=3, keepdim=True).mean(dim=2, keepdim=True)
        return x * F.hardsigmoid(self.fc(means))


def _stem(config: VoVNetConfig) -> nn.Sequential:
    """Three convolutions with a total stride of 4."""
    inputs = [3, *config.stem[:-1]]
    modules: list[tuple[str, nn.Module]] = []
    for i, stride in enumerate((2, 1, 2)):
        modules += _convolution(f"stem_{i + 1}", inputs[i], config.stem[i], 3, stride, config.batch_norm_eps)
    return _named(modules)


def _stage(index: int, in_channels: int, config: VoVNetConfig) -> nn.Sequential:
    """Pooling, except in the first stage; then OSA modules, with an identity connection except in the first one."""
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
    """A convolution, its BatchNorm and its ReLU, with their published names."""
    convolution = nn.Conv2d(in_channels, out_channels, size, stride=stride, padding=size // 2, bias=False)
    yield f"{name}/conv", convolution
    yield f"{name}/norm", nn.BatchNorm2d(out_channels, eps=eps)
    yield f"{name}/relu", nn.ReLU(inplace=True)


def _named(modules: Iterator[tuple[str, nn.Module]] | list[tuple[str, nn.Module]]) -> nn.Sequential:
    return nn.Sequential(OrderedDict(modules))
