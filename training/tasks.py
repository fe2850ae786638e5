"""Tasks: whether detection, maps or both are trained, and what this means for the model and its samples."""

from typing import NamedTuple

from torch import nn

from ..model import DuoSpaceNet, DuoSpaceNetConfig
from ..weights.trained_parts import model_parts
from .settings import Settings


class Tasks(NamedTuple):
    """Which tasks have a loss."""

    detection: bool
    maps: bool


BOTH_TASKS = Tasks(detection=True, maps=True)
NO_TASKS = Tasks(detection=False, maps=False)


def trained_tasks(settings: Settings, config: DuoSpaceNetConfig) -> Tasks:
    """The tasks that these settings train. Pretraining, and a model without map classes, train no maps."""
    detection = settings.pretraining or settings.tasks != "maps"
    return Tasks(detection, bool(config.map_classes) and not settings.pretraining and settings.tasks != "detection")


def num_past_frames(settings: Settings, config: DuoSpaceNetConfig) -> int:
    """The past frames of a sample, at most: none if the decoder is not trained, which alone uses them."""
    if settings.pretraining or not trained_tasks(settings, config).detection:
        return 0
    return config.num_frames - 1 if settings.past_frames is None else settings.past_frames


def unchanged_parts(settings: Settings, config: DuoSpaceNetConfig) -> set[str]:
    """The parts of the model, see `model_parts`, in which no parameter changes: without a loss, or frozen."""
    return parts_without_loss(settings, config) | set(settings.frozen_parts)


def parts_without_loss(settings: Settings, config: DuoSpaceNetConfig) -> set[str]:
    """The parts of the model on which no loss depends.

    Detection alone does not use the map segmentation, and maps alone do not use the queries and the decoder. A
    pretraining changes the image encoder only.
    """
    tasks = trained_tasks(settings, config)
    if settings.pretraining:
        return {part for part in model_parts(config) if part != "image_encoder"}
    without = set() if tasks.maps else {"segmentation"}
    if not tasks.detection:
        without |= {"queries", "decoder"}
    elif not tasks.maps and not config.attends_bev and not settings.bev_supervision:
        without |= {"lifter", "divergence_enhancement"}  # only the map segmentation uses the BEV features
    return without.intersection(model_parts(config))


def untrained_modules(model: DuoSpaceNet, settings: Settings) -> dict[str, nn.Module]:
    """The modules of the unchanged parts of a model, by name."""
    unchanged = unchanged_parts(settings, model.config)
    return {name: module for name, module in model.named_children() if name in unchanged}
