"""The data of a training: its clips, and the settings that depend on the data."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ...data.box_selection import BoxSelection
from ...data.source import Source
from ...runtime.errors import UsageError
from ...runtime.frame import GroundTruth
from ...runtime.progress import Progress
from ..notify import Notify
from ..sources import SourceNames
from .known_ground_truth import possible_settings, report_masks, report_tasks, select_boxes
from .requested_settings import settings_for
from .training_sources import TrainingSources, open_training_sources

if TYPE_CHECKING:
    from ...model import DuoSpaceNetConfig
    from ...training import Settings
    from ...training.samples.clips import Clips
    from ...training.samples.past_frames import PastFrames
    from ...training.samples.source_clips import FrameClasses


@dataclass(frozen=True)
class TrainingData:
    """The data of a training.

    clips: the clips to train on.
    settings: the settings, with the tasks that the ground truth allows, and with the number of steps of the epochs.
    anchor_truth: the ground truth that anchors are clustered from; empty if detection is not trained.
    source: all sources as one; None for synthetic scenes.
    """

    clips: "Clips"
    settings: "Settings"
    anchor_truth: Iterable[GroundTruth]
    source: Source | None


def open_training_data(
    sources: SourceNames | None,
    settings: "Settings",
    config: "DuoSpaceNetConfig",
    progress: Progress,
    notify: Notify,
) -> TrainingData:
    """Open the sources, and say what is trained on them and which ground truth is missing.

    sources: one or several sources; None trains on new synthetic scenes.
    progress: of the index of a nuScenes root.

    Raises UsageError for settings that do not fit the model or the sources. Raises InputError, naming the source, if
    there is nothing to train on in it, or if class names of its boxes are unknown.
    """
    from ...training.tasks import trained_tasks

    _check_settings(settings, config, sources)
    if sources is None:
        report_tasks(settings, config, notify)
        clips = _synthetic_clips(settings, config)
        truth = clips.ground_truth() if trained_tasks(settings, config).detection else ()
        return TrainingData(clips, settings_for(settings, config, None), truth, None)
    opened = open_training_sources(sources, config, trained_tasks(settings, config), progress)
    settings = possible_settings(settings, config, opened, notify)
    tasks = trained_tasks(settings, config)
    if tasks.maps:
        report_masks(opened, notify)
    selections = select_boxes(opened, config, notify) if tasks.detection else {}
    clips = _source_clips(opened, settings, config, selections)
    order = "class-balanced" if settings.class_balanced else "in random order"
    notify(f"an epoch has {clips.samples_per_epoch} training samples, {order}")
    anchor_truth = [selection.ground_truth for selection in selections.values()]
    return TrainingData(clips, settings_for(settings, config, clips.samples_per_epoch), anchor_truth, opened.source)


def check_first_clip(data: TrainingData, config: "DuoSpaceNetConfig") -> None:
    """Check that the first clip can be trained on, before anything is written. Raises InputError."""
    from ...training.samples.clip_loader import load_clips
    from ...weights.input_contract import preprocessing

    next(load_clips(data.clips, config, preprocessing(config), range(1), workers=0, settings=data.settings))


def _check_settings(settings: "Settings", config: "DuoSpaceNetConfig", sources: SourceNames | None) -> None:
    """Check that the settings fit the model and the kind of data. Raises UsageError."""
    from ...training.tasks import trained_tasks

    tasks = trained_tasks(settings, config)
    if not any(tasks):
        raise UsageError(f"--tasks: expected detection for {config.preset}, which has no map classes; got maps.")
    if settings.pretraining and settings.tasks == "maps":
        raise UsageError(
            "--pretraining: expected with --tasks both or detection, because it learns from boxes; got maps."
        )
    if settings.class_balanced and sources is None:
        raise UsageError("class_balanced: expected --source with it; got none. Synthetic scenes have no end.")
    if settings.class_balanced and not tasks.detection:
        raise UsageError("class_balanced: expected detection to be trained, because it counts boxes; got --tasks maps.")
    if settings.past_frames is not None and settings.past_frames >= config.num_frames:
        raise UsageError(
            f"past_frames: expected at most {config.num_frames - 1}, the past frames in the temporal window of "
            f"{config.preset}; got {settings.past_frames}."
        )


def _synthetic_clips(settings: "Settings", config: "DuoSpaceNetConfig") -> "Clips":
    from ...training.samples.synthetic_clips import SyntheticClips, SyntheticWindows

    drives = SyntheticClips(settings.seed, settings.frames_per_clip, config.voxels.size[:2])
    return drives if settings.history == "stream" else SyntheticWindows(drives, _past_frames(settings, config))


def _source_clips(
    opened: TrainingSources, settings: "Settings", config: "DuoSpaceNetConfig", selections: Mapping[int, BoxSelection]
) -> "Clips":
    from ...training.samples.source_clips import SourceClips, SourceWindows
    from ...training.tasks import trained_tasks
    from ...weights.input_contract import temporal_window

    source, limits = opened.source, temporal_window(config)
    trainable = opened.trainable(trained_tasks(settings, config))
    balance = _frame_classes(source, config, selections) if settings.class_balanced else None
    if settings.history == "windows":
        return SourceWindows(source, _past_frames(settings, config), limits, trainable, balance)
    return SourceClips(source, settings.seed, settings.frames_per_clip, limits, trainable, balance)


def _past_frames(settings: "Settings", config: "DuoSpaceNetConfig") -> "PastFrames":
    from ...training.samples.past_frames import PastFrames
    from ...training.tasks import num_past_frames

    return PastFrames(settings.seed, num_past_frames(settings, config), settings.history_strides)


def _frame_classes(
    source: Source, config: "DuoSpaceNetConfig", selections: Mapping[int, BoxSelection]
) -> "FrameClasses":
    """The classes of the training boxes in each frame."""
    from ...training.samples.source_clips import FrameClasses

    selected = (selections.get(index) for index in range(len(source)))
    of_frames = (frozenset() if selection is None else frozenset(selection.classes) for selection in selected)
    return FrameClasses(config.classes, tuple(of_frames))
