"""AdamW (Loshchilov and Hutter, 2019) with a linear warm-up and a cosine schedule, as in the paper.

The schedule is that of mmcv, which Sparse4D uses, with one difference: mmcv changes the cosine once per epoch, and this
one changes it at every step, as in SGDR (Loshchilov and Hutter, 2017).
"""

import math

import torch
from torch import nn

from ..model import DuoSpaceNet
from .settings import Settings


def make_optimiser(model: DuoSpaceNet, heads: nn.Module, settings: Settings) -> torch.optim.AdamW:
    """AdamW with two parameter groups: the backbone, and all other parameters of the model and of `heads`.

    Frozen parameters, which need no gradient, are left out. `peak` is a group's peak learning rate.
    """
    backbone = list(model.image_encoder.backbone.parameters())
    backbone_ids = {id(parameter) for parameter in backbone}
    others = [parameter for parameter in model.parameters() if id(parameter) not in backbone_ids]
    others += list(heads.parameters())
    groups = [
        {"params": _trained(backbone), "peak": settings.backbone_learning_rate},
        {"params": _trained(others), "peak": settings.learning_rate},
    ]
    # On a GPU, one kernel updates all parameters of a group. None leaves the choice to torch.
    fused = True if next(model.parameters()).is_cuda else None
    return torch.optim.AdamW(groups, lr=settings.learning_rate, weight_decay=settings.weight_decay, fused=fused)


def set_learning_rates(optimiser: torch.optim.Optimizer, step: int, settings: Settings) -> None:
    """Set the learning rate of each group for `step`, counted from 0."""
    for group in optimiser.param_groups:
        group["lr"] = group["peak"] * learning_rate_factor(step, settings)


def learning_rate_factor(step: int, settings: Settings) -> float:
    """The learning rate of `step` as a fraction of its peak: half a cosine period, times the warm-up.

    The cosine falls from 1 at step 0 to `final_learning_rate` after the last step. The warm-up grows linearly from
    `warmup_start` at step 0 to 1 at step `warmup_steps`.
    """
    cosine = (1 + math.cos(math.pi * step / settings.steps)) / 2
    factor = settings.final_learning_rate + (1 - settings.final_learning_rate) * cosine
    if step < settings.warmup_steps:
        factor *= settings.warmup_start + (1 - settings.warmup_start) * step / settings.warmup_steps
    return factor


def _trained(parameters: list[nn.Parameter]) -> list[nn.Parameter]:
    return [parameter for parameter in parameters if parameter.requires_grad]
