"""Held-out sources: the frames that a model in training is validated on."""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ...data.source import Source
from ...evaluation import EvaluationReport, Sample, evaluate
from ...evaluation.protocol import CLASSES
from ...runtime.errors import InputError, UsageError
from ...runtime.frame import GroundTruth
from ...runtime.progress import Progress
from ...runtime.validation import check_frame
from ..notify import Notify
from ..scoring import detect_samples
from ..sources import SourceName, SourceNames, map_grid, open_source, source_names
from .training_watch import report_scores

if TYPE_CHECKING:
    from ...model import DuoSpaceNet, DuoSpaceNetConfig
    from ...training import Settings, TrainingFolder
    from ...training.tasks import Tasks
    from ...training.watching.validator import Validator
    from .training_data import TrainingData

VALIDATE_EVERY = 1000  # steps
EXAMPLES = 3  # of frames, in a warning


def check_validation_options(validation: SourceNames | None, validate_every: int | None, settings: "Settings") -> None:
    """Check that the options of the validation fit together. Raises UsageError."""
    if validation is None and validate_every is not None:
        raise UsageError("--validate-every: expected only with --validation SOURCE; got none. Add --validation.")
    if validate_every is not None and validate_every < 1:
        raise UsageError(f"--validate-every: expected at least 1 step; got {validate_every}.")
    if validation is not None and settings.pretraining:
        raise UsageError(
            "--validation: expected a training of the whole model; got --pretraining, which only trains the image "
            "encoder. Leave one of the two out."
        )


def open_held_out_sources(
    names: SourceNames | None, config: "DuoSpaceNetConfig", data: "TrainingData", progress: Progress, notify: Notify
) -> "HeldOutSources | None":
    """Open held-out sources as `HeldOutSources` does, and warn of frames that are trained on. None without names."""
    if names is None:
        return None
    held_out = HeldOutSources(names, config, data.settings, progress)
    if data.source is not None:
        held_out.warn_of_overlap(data.source, notify)
    return held_out


class HeldOutSources:
    """Sources with ground truth that are not trained on. The boxes count if detection is trained, the maps if maps are.

    Scores are those of `duospacenet eval`, with the model in eager mode and float32.
    """

    def __init__(
        self, names: SourceNames, config: "DuoSpaceNetConfig", settings: "Settings", progress: Progress
    ) -> None:
        """Open the sources, and check that something can be evaluated on each of them.

        progress: of the index of a nuScenes root.

        Raises UsageError for a model with classes that the benchmark does not have. Raises InputError for a source that
        does not exist, without ground truth, or with unknown class names.
        """
        from ...training.tasks import trained_tasks

        self._tasks = trained_tasks(settings, config)
        unknown = [name for name in config.classes if name not in CLASSES]
        if self._tasks.detection and unknown:
            raise UsageError(
                f"--validation: expected a model with classes of nuScenes' benchmark, {', '.join(CLASSES)}; got "
                f"{unknown[0]!r}. Leave --validation out."
            )
        self._sources: list[Source] = []
        for name in source_names(names):
            source = open_source(name, map_grid(config.voxels, config.map_classes), progress)
            _check_ground_truth(source, name, self._tasks)
            _check_first_frame(source, name, config)
            self._sources.append(source)

    @property
    def identity(self) -> str:
        """A description of the frames and of what is evaluated on them."""
        tasks = " and ".join(name for name, is_trained in self._tasks._asdict().items() if is_trained)
        return f"{tasks} on {' + '.join(source.identity for source in self._sources)}"

    def evaluate(self, model: "DuoSpaceNet", progress: Progress) -> EvaluationReport:
        """Evaluate a model in evaluation mode.

        Raises InputError for a frame that the model cannot process, and if no frame can be evaluated.
        """
        from ...export.parity.eager_stream import EagerStream

        samples = detect_samples(EagerStream(model), self._sources, progress=progress)
        report = evaluate(map(self._of_tasks, samples))
        if not report.num_samples and not report.num_map_samples:
            raise InputError(
                "--validation: expected true boxes, or true masks of the model's map classes, in at least one frame; "
                "got none. Validate on another source."
            )
        return report

    def validator(
        self, folder: "TrainingFolder", validate_every: int | None, progress: Progress, notify: Notify
    ) -> "Validator":
        """The validator of a training in `folder`, whose log has its earlier validations."""
        from ...training.watching.validation_schedule import ValidationSchedule
        from ...training.watching.validator import Validator

        every = VALIDATE_EVERY if validate_every is None else validate_every
        schedule = ValidationSchedule(every, self.identity, folder.read_validations())
        return Validator(partial(self.evaluate, progress=progress), self.identity, schedule, report_scores(notify))

    def warn_of_overlap(self, trained: Source, notify: Notify) -> None:
        """Warn if frames of `trained`, a source that is trained on, are among the held-out frames."""
        trained_frames = set(_frame_keys(trained))
        keys = [key for source in self._sources for key in _frame_keys(source)]
        if common := [key.token for key in keys if key in trained_frames]:
            examples = ", ".join([*common[:EXAMPLES], *(["..."] if len(common) > EXAMPLES else [])])
            notify(
                f"warning: --validation: {len(common)} of {len(keys)} frames are trained on as well ({examples}), so "
                "the scores are better than on other frames"
            )

    def _of_tasks(self, sample: Sample) -> Sample:
        """The sample with the ground truth of the tasks that are trained."""
        truth = sample.ground_truth
        maps = truth.maps if self._tasks.maps else {}
        if not self._tasks.detection:
            return replace(sample, ground_truth=GroundTruth(np.zeros((0, 9)), (), maps, has_boxes=False))
        return replace(sample, ground_truth=replace(truth, maps=maps))


class _FrameKey(NamedTuple):
    """A key of a frame: different frames have different keys, also those of sources that count their tokens from 0."""

    token: str
    timestamp_s: float
    pose: bytes


def _frame_keys(source: Source) -> Iterator[_FrameKey]:
    for frame in map(source.frame_without_images, range(len(source))):
        yield _FrameKey(frame.token, float(frame.timestamp_s), np.asarray(frame.global_T_ego, np.float64).tobytes())


def _check_ground_truth(source: Source, name: SourceName, tasks: "Tasks") -> None:
    """Check that something can be evaluated on a source. Raises InputError."""
    indices = range(len(source))
    has_boxes = tasks.detection and any(map(source.has_boxes, indices))
    if has_boxes:
        source.check_class_names(CLASSES)
    elif not (tasks.maps and any(map(source.has_maps, indices))):
        expected = " or ".join(("true boxes",) * tasks.detection + ("true masks",) * tasks.maps)
        raise InputError(
            f"{name}: --validation: expected {expected} in at least one frame; got none. Validate on another source."
        )


def _check_first_frame(source: Source, name: SourceName, config: "DuoSpaceNetConfig") -> None:
    """Check that the model can process the first frame, before anything is written. Raises InputError."""
    frame = source.frame(0)
    try:
        check_frame(frame, config.num_cameras)
    except InputError as error:
        raise InputError(f"{name}: --validation: frame {frame.token}: {error}") from None
