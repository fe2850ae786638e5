"""The model of a training before its first step."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from ...runtime.errors import UsageError
from ...runtime.frame import GroundTruth
from ..models import load_starting_weights, notify_shards
from ..notify import Notify
from .initial_queries import place_queries

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
    anchors: Path | None = None,
) -> InitialModel:
    """The model before its first step: tensors from the checkpoint, the others randomly initialised.

    If detection is trained, queries without poses from the checkpoint start at anchors: those of a file, or clustered
    from the ground truth. So do queries of a checkpoint in which they are neither trained nor at anchors.

    Raises UsageError for an anchors file beside a checkpoint with trained queries, ArtifactError for a checkpoint or an
    anchors file that does not fit.
    """
    from ...model import DuoSpaceNet
    from ...training import initialise
    from ...training.tasks import trained_tasks
    from ...weights.starting_checkpoint import describe_start
    from ...weights.trained_parts import lacks_anchors, loaded_parts

    model = initialise(DuoSpaceNet(config), settings.seed, content_init=settings.content_init)
    report = None
    if weights is not None:
        notify_shards(weights, notify)
        report = load_starting_weights(model, weights, **selection)
        notify(f"{weights}: {report.verdict}")
        for line in [*describe_start(report), *(f"note: {note}" for note in report.notes)]:
            notify(line)
    _warn_of_frozen_random_weights(model, settings, report, notify)
    has_anchors = report is not None and "queries.pose" in report.matched and not lacks_anchors(report.metadata)
    if anchors is not None and has_anchors:
        raise UsageError(
            f"--anchors: expected weights without queries.pose; {weights} contains trained query positions, which "
            "anchors would overwrite. Leave --anchors out."
        )
    if anchors is not None or (trained_tasks(settings, config).detection and not has_anchors):
        place_queries(model, settings, ground_truth, anchors, notify)
    return InitialModel(model, loaded_parts(config, report))


def _warn_of_frozen_random_weights(
    model: "DuoSpaceNet", settings: "Settings", report: "CheckpointReport | None", notify: Notify
) -> None:
    """Warn if the training freezes something that has random weights, because it keeps them."""
    random = model.state_dict() if report is None else report.allowed_missing

    def warn(what: str, reason: str, setting: str) -> None:
        notify(
            f"warning: recipe {settings.recipe}: expected trained weights of the {what}, because {reason}; got random "
            f"ones. Give --weights with them, or use --set {setting}"
        )

    freezes_backbone = settings.frozen_stages or settings.backbone_norm_eval
    if freezes_backbone and any(name.startswith("image_encoder.backbone.") for name in random):
        warn("backbone", "parts of it are frozen", "frozen_stages=0 --set backbone_norm_eval=false")
    for part in settings.frozen_parts:
        if any(name.startswith(f"{part}.") for name in random):
            warn(part, "it is frozen", "'frozen_parts=[]'")
    if settings.norm_eval and any(name.endswith("running_var") for name in random):
        warn("BatchNorm layers", "their statistics are frozen", "norm_eval=false")
