"""The clips of a training, and what their ground truth has: boxes, classes and masks."""

from typing import TYPE_CHECKING

from ...data.box_selection import total_counts
from ...data.source import Source
from ...runtime.errors import InputError
from ...runtime.frame import GroundTruth
from ...runtime.progress import Progress
from ..notify import Notify
from ..sources import SourceNames, map_grid, open_sources

if TYPE_CHECKING:
    from ...model import DuoSpaceNetConfig
    from ...training import Settings
    from ...training.clips import Clips


def open_clips(
    sources: SourceNames | None,
    settings: "Settings",
    config: "DuoSpaceNetConfig",
    progress: Progress,
    notify: Notify,
) -> "Clips":
    """The clips to train on. Raises InputError if the boxes of a frame, or the names of their classes, are unknown."""
    from ...training.clips import SourceClips, SyntheticClips
    from ...weights.input_contract import temporal_window

    if sources is None:
        return SyntheticClips(settings.seed, settings.frames_per_clip, config.voxels.size[:2])
    opened = open_sources(sources, map_grid(config.voxels, config.map_classes), progress=progress)
    _check_known_boxes(opened)
    opened.check_class_names(config.classes)
    if config.map_classes and not settings.pretraining:
        _report_masks(opened, notify)
    return SourceClips(opened, settings.seed, settings.frames_per_clip, temporal_window(config))


def _check_known_boxes(source: Source) -> None:
    """Check that the true boxes of all frames are known, before anything is written. Raises InputError."""
    from ...training.training_frames import missing_boxes_error

    for index, token in enumerate(source.tokens):
        if not source.has_boxes(index):
            raise missing_boxes_error(token)


def _report_masks(source: Source, notify: Notify) -> None:
    """Report if some frames have no true masks. The maps are not trained on them."""
    num_masked = sum(map(source.has_maps, range(len(source))))
    if num_masked == 0:
        notify("warning: no frame has true masks, so the maps are not trained")
    elif num_masked < len(source):
        notify(f"ground truth: masks in {num_masked} of {len(source)} frames; the maps are trained on these only")


def check_boxes(clips: "Clips", config: "DuoSpaceNetConfig", notify: Notify) -> list[GroundTruth]:
    """Report how many boxes of a source are trained on, and which classes have none. Returns its ground truth.

    Raises InputError if no box is left to train on.
    """
    from ...training.training_frames import select_training_boxes

    ground_truth = list(clips.ground_truth())
    counts = total_counts(select_training_boxes(frame, config, "ground truth") for frame in ground_truth)
    lines = list(counts.lines())
    for line in lines:
        notify(f"ground truth: {line}")
    if not counts.num_used:
        raise InputError(
            f"ground truth: expected boxes of the model's classes within its voxel grid; got none in "
            f"{len(ground_truth)} frames{''.join(f'; {line}' for line in lines)}. Train on a source with such boxes."
        )
    notify(f"ground truth: {counts.num_used} boxes in {len(ground_truth)} frames to train on")
    if missing := [name for name in config.classes if not counts.used[name]]:
        notify(f"warning: ground truth: no box to train on of {', '.join(missing)}; the model will not find such objects")
    return ground_truth


def check_first_frame(clips: "Clips", config: "DuoSpaceNetConfig") -> None:
    """Check that the first frame can be trained on, before anything is written. Raises InputError."""
    from ...training.training_frames import make_training_frame
    from ...weights.input_contract import preprocessing

    make_training_frame(clips.frames(0)[0], config, preprocessing(config))
