"""Tasks: whether detection, maps or both are trained, and which parts of the model stay unchanged."""

from typing import NamedTuple

from torch import nn

from ..model import DuoSpaceNet, DuoSpaceNetConfig
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


def untrained_modules(model: DuoSpaceNet, settings: Settings) -> dict[str, nn.Module]:
    """The direct children of the model, by name, in which no parameter changes.

    Detection alone does not use the map segmentation, and maps alone do not use the queries and the decoder.
    """
    config, tasks = model.config, trained_tasks(settings, model.config)
    if settings.pretraining:
        return {name: module for name, module in model.named_children() if name != "image_encoder"}
    names = set() if tasks.maps else {"segmentation"}
    if not tasks.detection:
        names |= {"queries", "decoder"}
    elif not tasks.maps and not config.attends_bev and not settings.bev_supervision:
        names |= {"projector", "lifter", "divergence_enhancement"}  # only the map segmentation uses the BEV features
    return {name: module for name, module in model.named_children() if name in names}
