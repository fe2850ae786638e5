"""The model of a training before its first step, and the device that it is trained on."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...runtime.errors import UsageError
from ...runtime.frame import GroundTruth
from ..models import load_weights, notify_shards
from ..notify import Notify

if TYPE_CHECKING:
    import torch

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


def find_device(name: str) -> "torch.device":
    """The device with this name. Raises UsageError for an unknown device, or one that does not exist."""
    import torch

    if name not in ("auto", "cpu", "cuda"):
        raise UsageError(f"--device: expected auto, cpu or cuda; got {name!r}.")
    if name == "cuda" and not torch.cuda.is_available():
        raise UsageError("--device: expected a GPU for cuda; torch found none. Leave --device out to train on the CPU.")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")
