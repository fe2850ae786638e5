"""AdamW (Loshchilov and Hutter, 2019) with a cosine schedule after a linear warm-up, as the paper trains."""

import math

import torch
from torch import nn

from ..model import DuoSpaceNet
from .settings import Settings


def make_optimiser(model: DuoSpaceNet, extra: nn.Module, settings: Settings) -> torch.optim.AdamW:
    """Two groups of parameters: the backbone's, and the others with those of `extra`. `peak` is a group's own rate."""
    backbone = list(model.image_encoder.backbone.parameters())
    known = {id(parameter) for parameter in backbone}
    others = [parameter for parameter in model.parameters() if id(parameter) not in known]
    others += list(extra.parameters())
    groups = [
        {"params": backbone, "peak": settings.backbone_learning_rate},
        {"params": others, "peak": settings.learning_rate},
    ]
    return torch.optim.AdamW(groups, lr=settings.learning_rate, weight_decay=settings.weight_decay)


def set_rates(optimiser: torch.optim.Optimizer, step: int, settings: Settings) -> None:
    """The learning rates of step `step`, counted from 0."""
    for group in optimiser.param_groups:
        group["lr"] = group["peak"] * share_of_peak(step, settings)


def share_of_peak(step: int, settings: Settings) -> float:
    """The learning rate of step `step` as a share of its peak: up a line, then down half a cosine to nothing."""
    if step < settings.warmup_steps:
        return (step + 1) / settings.warmup_steps
    done = (step - settings.warmup_steps) / max(1, settings.steps - settings.warmup_steps)
    return (1 + math.cos(math.pi * min(1.0, done))) / 2
