"""Initial weights for training. Parity checks use other random weights, from `model.randomise`."""

import math
from typing import Literal

import torch
from torch import Tensor, nn

from ..model import DuoSpaceNet
from ..model.attention import DeformableAttention
from ..model.backbones.deformable_convolution import DeformableConvolution
from ..model.decoder import PredictionHeads
from ..model.queries import initial_poses, place_anchors
from ..model.segmentation import MapSegmentation

PRIOR = 0.01  # initial score of every class (Lin et al., 2017, section 4.1)
CLASS_WEIGHT_STD = 0.01  # of the last layer of the class and map heads (same section)


@torch.no_grad()
def initialise(
    model: DuoSpaceNet,
    seed: int,
    anchors: Tensor | None = None,
    content_init: Literal["normal", "xavier"] = "normal",
) -> DuoSpaceNet:
    """Initialise every parameter of `model` from `seed` and reset all running statistics, in place.

    Convolutions: Kaiming. Linear layers: Xavier. Normalisations: the identity.
    Deformable attention: as in Deformable-DETR. Class heads: as in the focal loss paper.
    Map heads: a probability of about 0.5 in every cell. Pose refinement: zero, so every layer predicts its input pose.

    anchors: (Q, 3) [m], the initial query positions in the ego frame. Without anchors they are random, uniform over the
        perception range.
    content_init: the distribution of the content embeddings. "normal": a standard deviation of 1. "xavier": uniform,
        for the content (Q, C) of each space, as the instance features of Sparse4D v2.

    Returns `model`. Load pretrained weights after this call, because it overwrites all weights. Raises ValueError if
    the number of anchors is not the number of queries, or if an anchor is not finite.
    """
    generator = torch.Generator().manual_seed(seed)
    initialise_modules(model, generator)
    _initialise_queries(model, generator, anchors, content_init)
    return model


@torch.no_grad()
def initialise_modules(model: nn.Module, generator: torch.Generator) -> None:
    """Initialise the modules of `model`, which can be any module, by their types, in place."""
    for module in model.modules():
        _initialise_layer(module, generator)
    # These modules contain layers of the types above, so they must come second.
    for module in model.modules():
        if isinstance(module, DeformableAttention):
            _initialise_deformable_attention(module, generator)
        elif isinstance(module, PredictionHeads):
            _initialise_prediction_heads(module, generator)
        elif isinstance(module, DeformableConvolution):
            _initialise_deformable_convolution(module, generator)
        elif isinstance(module, MapSegmentation):
            _initialise_map_heads(module, generator)


def _initialise_layer(module: nn.Module, generator: torch.Generator) -> None:
    if isinstance(module, (nn.Conv2d, nn.Conv3d)):
        nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu", generator=generator)
    elif isinstance(module, nn.Linear):
        nn.init.xavier_uniform_(module.weight, generator=generator)
    elif isinstance(module, (nn.BatchNorm2d, nn.BatchNorm3d, nn.LayerNorm)):
        module.reset_parameters()
    else:
        return
    if module.bias is not None:
        nn.init.zeros_(module.bias)


def _initialise_deformable_attention(attention: DeformableAttention, generator: torch.Generator) -> None:
    """As in Deformable-DETR: one direction per head, and equal attention weights for all sampling points."""
    _set_to_zero(attention.offsets)
    attention.offsets.bias.copy_(attention.outward_offsets())
    _set_to_zero(attention.weights)
    nn.init.xavier_uniform_(attention.value.weight, generator=generator)


def _initialise_deformable_convolution(convolution: DeformableConvolution, generator: torch.Generator) -> None:
    """Zero offsets, and a modulation of 0.5 (Zhu et al., 2019)."""
    _set_to_zero(convolution.conv_offset)
    nn.init.kaiming_normal_(convolution.weight, mode="fan_out", nonlinearity="relu", generator=generator)


def _initialise_prediction_heads(heads: PredictionHeads, generator: torch.Generator) -> None:
    classes = _last_linear(heads.classes)
    nn.init.normal_(classes.weight, 0.0, CLASS_WEIGHT_STD, generator=generator)
    nn.init.constant_(classes.bias, -math.log((1 - PRIOR) / PRIOR))
    _set_to_zero(_last_linear(heads.refinement))


def _initialise_map_heads(segmentation: MapSegmentation, generator: torch.Generator) -> None:
    """A probability of about 0.5 in every cell."""
    for head in segmentation.heads.values():
        logits = [module for module in head.modules() if isinstance(module, nn.Conv2d)][-1]
        nn.init.normal_(logits.weight, 0.0, CLASS_WEIGHT_STD, generator=generator)


def _initialise_queries(
    model: DuoSpaceNet, generator: torch.Generator, anchors: Tensor | None, content_init: str
) -> None:
    """Random content. Poses of the size of a car, with a yaw of 0 and no velocity."""
    if content_init == "xavier":
        for content in model.queries.content.split(model.config.channels, dim=-1):
            nn.init.xavier_uniform_(content, generator=generator)
    else:
        nn.init.normal_(model.queries.content, generator=generator)
    model.queries.pose.copy_(initial_poses(model.config, generator))
    if anchors is not None:
        place_anchors(model.queries.pose, anchors)


def _last_linear(head: nn.Module) -> nn.Linear:
    return [module for module in head.modules() if isinstance(module, nn.Linear)][-1]


def _set_to_zero(module: nn.Module) -> None:
    for parameter in module.parameters():
        nn.init.zeros_(parameter)
