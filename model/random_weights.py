"""Random weights for parity checks: no tensor is constant, and no activation explodes."""

import torch
from torch import nn

from .attention import DeformableAttention
from .backbones.deformable_convolution import DeformableConvolution
from .backbones.resnet import BasicBlock, Bottleneck
from .backbones.vovnet import OneShotAggregation
from .duospacenet import DuoSpaceNet
from .queries import initial_poses

_PIXEL_STD = 57.0  # standard deviation of the pixels of photographs, from 0 to 255


@torch.no_grad()
def randomise(model: DuoSpaceNet, seed: int = 0) -> DuoSpaceNet:
    """Set every parameter and running statistic of `model` to random values, in place, and return the model.

    With the usual initial weights a parity check misses mistakes: two swapped tensors of zeros, or of ones, give the
    same result. Here the values of each tensor have a small spread around the usual initial value.

    Does not use torch's global generator.
    """
    generator = torch.Generator().manual_seed(seed)
    for module in model.modules():
        if isinstance(module, (nn.Conv2d, nn.Conv3d, DeformableConvolution)):
            nn.init.kaiming_normal_(module.weight, generator=generator)
        elif isinstance(module, nn.Linear):
            nn.init.xavier_uniform_(module.weight, generator=generator)
        elif isinstance(module, (nn.BatchNorm2d, nn.BatchNorm3d)):
            nn.init.normal_(module.weight, 1.0, 0.1, generator=generator)
            nn.init.normal_(module.running_mean, 0.0, 0.1, generator=generator)
            nn.init.uniform_(module.running_var, 0.8, 1.2, generator=generator)
        elif isinstance(module, nn.LayerNorm):
            nn.init.normal_(module.weight, 1.0, 0.1, generator=generator)
    for name, parameter in model.named_parameters():
        if name.endswith("bias"):
            nn.init.normal_(parameter, 0.0, 0.1, generator=generator)
    _point_offsets_outward(model)
    _scale_activations(model)
    _spread_offsets(model)
    _scale_aggregations(model)
    _scale_refinement(model)
    _sample_queries(model, generator)
    return model


def _point_offsets_outward(model: nn.Module) -> None:
    for module in model.modules():
        if isinstance(module, DeformableAttention):
            module.offsets.bias += module.outward_offsets()


def _scale_activations(model: DuoSpaceNet) -> None:
    """Scale the first convolution and the residual branches. Without trained statistics the activations would grow."""
    encoder = model.image_encoder
    encoder.first_convolution.weight *= encoder.normalisation.std.mean() / _PIXEL_STD
    for module in model.modules():
        if isinstance(module, Bottleneck):
            module.bn3.weight *= 0.5
        elif isinstance(module, BasicBlock):
            module.bn2.weight *= 0.5


def _spread_offsets(model: nn.Module) -> None:
    """Give deformable convolutions offsets of one or two pixels. Their input features have values up to about 10."""
    for module in model.modules():
        if isinstance(module, DeformableConvolution):
            module.conv_offset.weight.mul_(0.1)
            module.conv_offset.bias.mul_(10)


def _scale_aggregations(model: nn.Module) -> None:
    """Scale the OSA modules of a VoVNet.

    An untrained eSE halves its input. Without an identity connection the features would vanish from stage to stage.
    With one, they would still grow.
    """
    for module in model.modules():
        if isinstance(module, OneShotAggregation):
            module.concat[1].get_parameter("weight").mul_(0.4 if module.identity else 1.5)


def _scale_refinement(model: DuoSpaceNet) -> None:
    """Limit refinements to decimetres. With an unscaled random head, boxes would reach hundreds of metres."""
    for layer in model.decoder.layers:
        layer.heads.refinement[-1].weight *= 0.2


def _sample_queries(model: DuoSpaceNet, generator: torch.Generator) -> None:
    """Give the queries random headings and velocities. Without them, motion compensation would have no effect."""
    queries, pose = model.queries, initial_poses(model.config, generator)
    yaw_rad = 2 * torch.pi * torch.rand(len(pose), generator=generator)
    pose[:, 6], pose[:, 7] = yaw_rad.sin(), yaw_rad.cos()
    pose[:, 8:] = 5 * torch.randn(len(pose), 2, generator=generator)
    queries.pose.copy_(pose)
    nn.init.normal_(queries.content, generator=generator)
