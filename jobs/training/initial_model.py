"""The model of a training before its first step."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...runtime.frame import GroundTruth
from ..models import load_weights, notify_shards
from ..notify import Notify

if TYPE_CHECKING:
    from ...model import DuoSpaceNet, DuoSpaceNetConfig
    from ...training import Settings


def initial_model(
    config: "DuoSpaceNetConfig",
    settings: "Settings",
    ground_truth: Iterable[GroundTruth],
    weights: Path | None,
    selection: dict[str, Any],
    notify: Notify,
) -> "DuoSpaceNet":
    """The model before its first step: tensors from the checkpoint, the others randomly initialised.

    Queries without poses from the checkpoint start at anchors, which are clustered from the ground truth.
    """
    from ...model import DuoSpaceNet
    from ...model.queries import place_anchors, resize_anchors
    from ...training import initialise
    from ...training.initial_anchors import find_initial_anchors, mean_box_size

    model = initialise(DuoSpaceNet(config), settings.seed, content_init=settings.content_init)
    report = None
    if weights is not None:
        notify_shards(weights, notify)
        report = load_weights(model, weights, **selection)
        notify(f"{weights}: {report.verdict}")
        for note in report.notes:
            notify(f"note: {note}")
    if report is None or "queries.pose" not in report.matched:
        notify("clustering anchors ...")
        ground_truth = list(ground_truth)
        anchors = find_initial_anchors(ground_truth, config.num_queries, settings.seed, config.classes)
        place_anchors(model.queries.pose, anchors)
        if settings.anchor_size == "mean":
            resize_anchors(model.queries.pose, mean_box_size(ground_truth, config.classes))
    return model
