"""The model of a training before its first step."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...runtime.frame import GroundTruth
from ..models import load_weights, notify_shards
from ..notify import Notify

if TYPE_CHECKING:
    from ...model import DuoSpaceNet, DuoSpaceNetConfig
    from ...training import Settings
    from ...weights.checkpoint_report import CheckpointReport
    from ...weights.trained_parts import IsTrained


class InitialModel(NamedTuple):
    """A model before its first step, and which parts of it are trained already."""

    model: "DuoSpaceNet"
    trained_parts: "IsTrained"


def initial_model(
    config: "DuoSpaceNetConfig",
    settings: "Settings",
    ground_truth: Iterable[GroundTruth],
    weights: Path | None,
    selection: dict[str, Any],
    notify: Notify,
) -> InitialModel:
    """The model before its first step: tensors from the checkpoint, the others randomly initialised.

    If detection is trained, queries without poses from the checkpoint start at anchors, which are clustered from the
    ground truth. So do queries of a checkpoint in which they are neither trained nor at anchors.
    """
    from ...model import DuoSpaceNet
    from ...model.queries import place_anchors, resize_anchors
    from ...training import initialise
    from ...training.initial_anchors import find_initial_anchors, mean_box_size
    from ...training.tasks import trained_tasks
    from ...weights.trained_parts import lacks_anchors, loaded_parts

    model = initialise(DuoSpaceNet(config), settings.seed, content_init=settings.content_init)
    report = None
    if weights is not None:
        notify_shards(weights, notify)
        report = load_weights(model, weights, **selection)
        notify(f"{weights}: {report.verdict}")
        for note in report.notes:
            notify(f"note: {note}")
    _warn_of_frozen_random_weights(model, settings, report, notify)
    has_anchors = report is not None and "queries.pose" in report.matched and not lacks_anchors(report.metadata)
    if trained_tasks(settings, config).detection and not has_anchors:
        notify("clustering anchors ...")
        ground_truth = list(ground_truth)
        anchors = find_initial_anchors(ground_truth, config.num_queries, settings.seed, config.classes)
        place_anchors(model.queries.pose, anchors)
        if settings.anchor_size == "mean":
            resize_anchors(model.queries.pose, mean_box_size(ground_truth, config.classes))
    return InitialModel(model, loaded_parts(config, report))


def _warn_of_frozen_random_weights(
    model: "DuoSpaceNet", settings: "Settings", report: "CheckpointReport | None", notify: Notify
) -> None:
    """Warn if frozen parts of the backbone have random weights, because they keep them."""
    if not (settings.frozen_stages or settings.backbone_norm_eval):
        return
    loaded = {} if report is None else report.matched
    if all(f"image_encoder.backbone.{name}" in loaded for name, _ in model.image_encoder.backbone.named_parameters()):
        return
    notify(
        f"warning: recipe {settings.recipe}: expected a pre-trained backbone in --weights, because parts of it stay "
        "unchanged; got random weights. Without such weights, use --set frozen_stages=0 --set backbone_norm_eval=false"
    )
