"""What training starts from. `model.randomise` is another thing: weights for proofs."""

import math

import numpy as np
import torch
from torch import Tensor, nn

from ..data.anchor_clustering import centres_within_range, cluster_centres
from ..model import DuoSpaceNet
from ..model.attention import DeformableAttention
from ..model.backbones.deformable_convolution import DeformableConvolution
from ..model.decoder import PredictionHeads
from ..model.queries import place_anchors, spread_poses
from ..model.segmentation import MapSegmentation
from .clips import Clips

PRIOR = 0.01  # the score of every class before training (Lin et al., 2017, section 4.1)
CLASS_WEIGHT_STD = 0.01  # of the last layers of classes and masks, as there


@torch.no_grad()
def initialise(model: DuoSpaceNet, seed: int, anchors: Tensor | None = None) -> DuoSpaceNet:
    """Draw every parameter of `model` from `seed` and reset every running statistic, in place; returns it.

    Convolutions: Kaiming; linear layers: Xavier; normalisations: the identity; MSDA and the class head: as
    Deformable-DETR and the focal loss begin, the masks nearly flat; a layer's refinement: zero, so that it predicts the
    pose it was given.
    anchors (Q, 3) [m]: where the queries start, in the ego frame; None spreads them over the perception range. Weights
    of a trained backbone are loaded after this. Raises ValueError for anchors of another number.
    """
    generator = torch.Generator().manual_seed(seed)
    initialise_parts(model, generator)
    _start_queries(model, generator, anchors)
    return model


@torch.no_grad()
def initialise_parts(model: nn.Module, generator: torch.Generator) -> None:
    """Draw what lies in modules of a known type, whichever model they are part of, in place."""
    for module in model.modules():
        _start(module, generator)
    for module in model.modules():  # what is made of parts that were drawn above
        if isinstance(module, DeformableAttention):
            _start_deformable_attention(module, generator)
        elif isinstance(module, PredictionHeads):
            _start_heads(module, generator)
        elif isinstance(module, DeformableConvolution):
            _start_deformable_convolution(module, generator)
        elif isinstance(module, MapSegmentation):
            _start_masks(module, generator)


def _start(module: nn.Module, generator: torch.Generator) -> None:
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


def _start_deformable_attention(attention: DeformableAttention, generator: torch.Generator) -> None:
    """Deformable-DETR's: every query looks alike, every head its own way, every point counts the same."""
    _zero(attention.offsets)
    attention.offsets.bias.copy_(attention.outward_offsets())
    _zero(attention.weights)
    nn.init.xavier_uniform_(attention.value.weight, generator=generator)


def _start_deformable_convolution(convolution: DeformableConvolution, generator: torch.Generator) -> None:
    """No offsets, and every sample weighed by a half (Zhu et al., 2019)."""
    _zero(convolution.conv_offset)
    nn.init.kaiming_normal_(convolution.weight, mode="fan_out", nonlinearity="relu", generator=generator)


def _start_heads(heads: PredictionHeads, generator: torch.Generator) -> None:
    classes = _last_linear(heads.classes)
    nn.init.normal_(classes.weight, 0.0, CLASS_WEIGHT_STD, generator=generator)
    nn.init.constant_(classes.bias, -math.log((1 - PRIOR) / PRIOR))
    _zero(_last_linear(heads.refinement))


def _start_masks(segmentation: MapSegmentation, generator: torch.Generator) -> None:
    """Every cell is as likely as not."""
    for head in segmentation.heads.values():
        logits = [module for module in head.modules() if isinstance(module, nn.Conv2d)][-1]
        nn.init.normal_(logits.weight, 0.0, CLASS_WEIGHT_STD, generator=generator)


def _start_queries(model: DuoSpaceNet, generator: torch.Generator, anchors: Tensor | None) -> None:
    """Content as an embedding's; poses car-sized, looking ahead, at rest."""
    nn.init.normal_(model.queries.content, generator=generator)
    model.queries.pose.copy_(spread_poses(model.config, generator))
    if anchors is not None:
        place_anchors(model.queries.pose, anchors)


def _last_linear(head: nn.Module) -> nn.Linear:
    return [module for module in head.modules() if isinstance(module, nn.Linear)][-1]


def _zero(module: nn.Module) -> None:
    for parameter in module.parameters():
        nn.init.zeros_(parameter)


def find_initial_anchors(drives: Clips, num_queries: int, seed: int) -> Tensor:
    """Centres (Q, 3) [m] in the ego frame. Raises InputError where the drives hold too few objects."""
    centres = list(drives.ground_truth_centres())
    return torch.from_numpy(
        cluster_centres(centres_within_range(centres, num_queries), num_queries, seed).centroids.astype(np.float32)
    )
