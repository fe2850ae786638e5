"""The known ground truth of a training's sources: which tasks it allows, and messages about what is missing."""

from collections.abc import Iterator
from dataclasses import replace
from typing import TYPE_CHECKING

from ...data.box_selection import BoxSelection, total_counts
from ...runtime.errors import InputError
from ...runtime.frame import GroundTruth
from ..notify import Notify
from .training_sources import TrainingSources

if TYPE_CHECKING:
    from ...model import DuoSpaceNetConfig
    from ...training import Settings


def possible_settings(
    settings: "Settings", config: "DuoSpaceNetConfig", sources: TrainingSources, notify: Notify
) -> "Settings":
    """The settings with the tasks for which there is ground truth. Says which task is not trained, and why."""
    from ...training.tasks import trained_tasks

    tasks = trained_tasks(settings, config)
    if tasks.maps and not sources.with_masks:
        notify("warning: no frame has true masks, so the maps are not trained")
        return replace(settings, tasks="detection")
    if tasks.detection and not sources.with_boxes:
        notify("warning: no frame has true boxes, so detection is not trained")
        return replace(settings, tasks="maps", class_balanced=False)  # the classes are those of boxes
    report_tasks(settings, config, notify)
    return settings


def report_tasks(settings: "Settings", config: "DuoSpaceNetConfig", notify: Notify) -> None:
    """Say which part of the model is not trained because of the chosen tasks, and which parts are frozen."""
    from ...training.tasks import trained_tasks

    tasks = trained_tasks(settings, config)
    if not tasks.detection:
        notify("tasks: maps only; the queries and the decoder are not trained")
    elif config.map_classes and not tasks.maps and not settings.pretraining:
        notify("tasks: detection only; the map segmentation is not trained")
    if settings.frozen_parts:
        notify(f"frozen: {', '.join(settings.frozen_parts)}")


def report_masks(sources: TrainingSources, notify: Notify) -> None:
    """Report if some frames have no true masks. The maps are not trained on them."""
    num_masked, num_frames = len(sources.with_masks), len(sources.source)
    if num_masked < num_frames:
        notify(f"ground truth: masks in {num_masked} of {num_frames} frames; the maps are trained on these only")


def select_boxes(sources: TrainingSources, config: "DuoSpaceNetConfig", notify: Notify) -> dict[int, BoxSelection]:
    """Report how many boxes of a source are trained on, and which classes have none.

    Returns the selected boxes of each frame with known boxes, by the index of the frame. Raises InputError if no box is
    left to train on.
    """
    from ...training.samples.training_frames import select_training_boxes

    known, num_frames = dict(_known_boxes(sources)), len(sources.source)
    selections = {index: select_training_boxes(truth, config, "ground truth") for index, truth in known.items()}
    counts = total_counts(selections.values())
    lines = list(counts.lines())
    for line in lines:
        notify(f"ground truth: {line}")
    if not counts.num_used:
        raise InputError(
            f"ground truth: expected boxes of the model's classes within its voxel grid; got none in {len(known)} "
            f"frames{''.join(f'; {line}' for line in lines)}. Train on a source with such boxes."
        )
    if len(known) < num_frames:
        notify(f"ground truth: boxes in {len(known)} of {num_frames} frames; detection is trained on these only")
    notify(f"ground truth: {counts.num_used} boxes in {len(known)} frames to train on")
    if missing := [name for name in config.classes if not counts.used[name]]:
        notify(
            f"warning: ground truth: no box to train on of {', '.join(missing)}; the model will not find such objects"
        )
    return selections


def _known_boxes(sources: TrainingSources) -> Iterator[tuple[int, GroundTruth]]:
    """The index and the ground truth, without maps, of each frame whose boxes are known."""
    for index in sorted(sources.with_boxes):
        ground_truth = sources.source.ground_truth_without_maps(index)
        assert ground_truth is not None
        yield index, ground_truth
