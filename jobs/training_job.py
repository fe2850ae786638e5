"""Training in a folder, which holds the weights, the training state, the log and the loss curves. It can be resumed."""

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from ..data.box_selection import total_counts
from ..data.source import Source
from ..runtime.errors import InputError, OutputError, UsageError
from ..runtime.extras import needs_extra
from ..runtime.frame import GroundTruth
from ..runtime.json_record import describe_first_error
from ..runtime.progress import Progress, no_progress
from .folder_lock import lock_folder
from .models import check_checkpoint_options, load_weights, notify_shards, optional_path, preset_or_config
from .notify import Notify
from .notify import ignore as ignore_message
from .output_folder import check_writable, make_folders
from .resuming import check_same_settings
from .sources import SourceNames, map_grid, open_sources

if TYPE_CHECKING:
    import torch

    from ..model import DuoSpaceNet, DuoSpaceNetConfig
    from ..training import Settings, Trainer, TrainingFolder
    from ..training.clips import Clips
    from ..training.trainer import TrainingStep

CURVES_NAME = "losses.png"
NOTIFY_EVERY = 100  # steps


@dataclass(frozen=True)
class TrainingSummary:
    """The result of a training. loss: mean of the newest total losses; None if no step was left to do."""

    weights: Path
    steps: int
    loss: float | None

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return {**vars(self), "weights": str(self.weights)}


def training_settings(values: Mapping[str, Any]) -> "Settings":
    """The settings of a training from option values.

    values: fields of `Settings`; a `backbone_learning_rate` of None means the same rate as for the other parts.
    Raises UsageError that names the option of an invalid value.
    """
    with needs_extra("train"):
        from ..training import Settings
    backbone_rate = values["backbone_learning_rate"]
    rates = {"backbone_learning_rate": values["learning_rate"] if backbone_rate is None else backbone_rate}
    try:
        return Settings(**{**values, **rates})
    except ValidationError as error:
        # A default may repeat another option's wrong value, so that the number of errors would mislead.
        raise UsageError(f"--{describe_first_error(error, count=False).replace('_', '-')}.") from None


def train_model(
    config: "DuoSpaceNetConfig | str",
    settings: "Settings",
    out: str | Path,
    *,
    sources: SourceNames | None = None,
    weights: str | Path | None = None,
    allow_missing: Sequence[str] | None = None,
    ignore: Sequence[str] | None = None,
    weights_key: str | None = None,
    device: str = "auto",
    workers: int = 1,
    save_every: int = 200,
    resume: bool = False,
    progress: Progress = no_progress,
    notify: Notify = ignore_message,
) -> TrainingSummary:
    """Train a model, and keep its weights, its state, its log and its loss curves in the folder `out`.

    sources: one or several sources with ground truth; None trains on new synthetic scenes. A clip never spans two
        sources.
    weights: a checkpoint to start from; None starts from a random initialisation.
    allow_missing: patterns of tensors that the checkpoint may lack.
    ignore: patterns of tensors in the checkpoint that are not loaded.
    weights_key: the key of the weights in the checkpoint, if it holds several copies.
    device: "auto", "cpu" or "cuda".
    workers: processes that prepare the next clips.
    save_every: steps between checkpoints.
    resume: continue from the last checkpoint in `out`.
    Raises a DuoSpaceNetError before anything is written if an argument or the folder is not valid.
    Raises InputError for a frame without the ground truth that is needed.
    """
    with needs_extra("train"):
        from ..training import Trainer, TrainingFolder, TrainingRecord
        from ..training.training_folder import WEIGHTS_NAME
    with needs_extra("viz"):
        from ..training import loss_curves  # noqa: F401
    from ..weights.provenance import hash_weights

    out, weights = Path(out), optional_path(weights)
    config = preset_or_config(config)
    check_checkpoint_options(weights, allow_missing, ignore, weights_key)
    selection = {"allow_missing": allow_missing, "ignore": ignore, "weights_key": weights_key}
    torch_device = _find_device(device)
    check_training_folder(out, resume)
    clips = _open_clips(sources, settings, config, progress, notify)
    ground_truth = clips.ground_truth() if sources is None else _check_boxes(clips, config, notify)
    learned = replace(config, map_classes=()) if settings.pretraining else config
    _check_first_frame(clips, learned)
    model = _initial_model(config, settings, ground_truth, weights, selection, notify)
    trainer = Trainer(model, settings, torch_device)
    folder = TrainingFolder(out, TrainingRecord(config, settings, clips.identity, hash_weights(trainer.model)))
    make_folders(out, ("",))
    with lock_folder(out, notify):
        check_training_folder(out, resume)  # again: another training may have written here before the lock
        begin_or_resume(folder, trainer, resume)
        steps = _training_steps(folder, trainer, clips, learned, workers, save_every)
        loss = _train_with_curves(
            folder, progress(steps, f"training {config.preset}", settings.steps - trainer.step), notify
        )
    return TrainingSummary(out / WEIGHTS_NAME, settings.steps, loss)


def check_training_folder(out: Path, resume: bool) -> None:
    """Check that a training may start in `out`, or be resumed there. Changes nothing.

    Raises OutputError for the folder of another training, or files that no training wrote. Raises UsageError if there
    is nothing to resume.
    """
    from ..training.training_folder import CHECKPOINT_NAME, LOG_NAME, TRAINING_NAME, WEIGHTS_NAME

    check_writable(out)
    exists = (out / TRAINING_NAME).exists()
    if resume and not exists:
        raise UsageError(f"--resume: expected {TRAINING_NAME} in {out}; got none. Leave --resume out to start.")
    if exists and not resume:
        raise OutputError(f"{out}: an earlier training wrote this folder. Choose another --out, or add --resume.")
    for name in () if exists else (CHECKPOINT_NAME, LOG_NAME, WEIGHTS_NAME, CURVES_NAME):
        if (out / name).exists():
            raise OutputError(
                f"{out / name}: no {TRAINING_NAME} shows that a training wrote this file. Choose another --out."
            )


def _find_device(name: str) -> "torch.device":
    """The device with this name. Raises UsageError for an unknown device, or one that does not exist."""
    import torch

    if name not in ("auto", "cpu", "cuda"):
        raise UsageError(f"--device: expected auto, cpu or cuda; got {name!r}.")
    if name == "cuda" and not torch.cuda.is_available():
        raise UsageError("--device: expected a GPU for cuda; torch found none. Leave --device out to train on the CPU.")
    return torch.device("cuda" if name != "cpu" and torch.cuda.is_available() else "cpu")


def _open_clips(
    sources: SourceNames | None,
    settings: "Settings",
    config: "DuoSpaceNetConfig",
    progress: Progress,
    notify: Notify,
) -> "Clips":
    """The clips to train on. Raises InputError if the boxes of a frame, or the names of their classes, are unknown."""
    from ..training.clips import SourceClips, SyntheticClips
    from ..weights.input_contract import temporal_window

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
    from ..training.training_frames import missing_boxes_error

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


def _check_boxes(clips: "Clips", config: "DuoSpaceNetConfig", notify: Notify) -> list[GroundTruth]:
    """Report how many boxes of a source are trained on. Returns the ground truth of its frames.

    Raises InputError if no box is left to train on.
    """
    from ..training.training_frames import select_training_boxes

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
    return ground_truth


def _check_first_frame(clips: "Clips", config: "DuoSpaceNetConfig") -> None:
    """Check that the first frame can be trained on, before anything is written. Raises InputError."""
    from ..training.training_frames import make_training_frame
    from ..weights.input_contract import preprocessing

    make_training_frame(clips.frames(0)[0], config, preprocessing(config))


def _initial_model(
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
    from ..model import DuoSpaceNet
    from ..model.queries import place_anchors
    from ..training import initialise
    from ..training.initial_anchors import find_initial_anchors

    model = initialise(DuoSpaceNet(config), settings.seed)
    report = None
    if weights is not None:
        notify_shards(weights, notify)
        report = load_weights(model, weights, **selection)
        notify(f"{weights}: {report.verdict}")
        for note in report.notes:
            notify(f"note: {note}")
    if report is None or "queries.pose" not in report.matched:
        notify("clustering anchors ...")
        anchors = find_initial_anchors(ground_truth, config.num_queries, settings.seed, config.classes)
        place_anchors(model.queries.pose, anchors)
    return model


def begin_or_resume(folder: "TrainingFolder", trainer: "Trainer", resume: bool) -> None:
    """Write the record of a new training, or load the state of an interrupted one.

    Raises UsageError if the interrupted training has another record, ArtifactError for files that cannot be read.
    """
    from ..training.training_folder import TRAINING_NAME
    from ..training.training_record import flatten_record

    if resume:
        requested = flatten_record(folder.record.to_dict())
        record_path = folder.path / TRAINING_NAME
        check_same_settings("training", record_path, folder.read_record(), requested, "choose another --out")
    else:
        folder.write_record()
    folder.resume(trainer)


def _training_steps(
    folder: "TrainingFolder",
    trainer: "Trainer",
    clips: "Clips",
    config: "DuoSpaceNetConfig",
    workers: int,
    save_every: int,
) -> "Iterator[TrainingStep]":
    """Train to the end. Yields every step."""
    from ..training import train
    from ..training.clip_loader import load_clips, remaining_clips
    from ..weights.input_contract import preprocessing

    numbers = remaining_clips(clips, trainer.settings, trainer.step)
    return train(trainer, folder, load_clips(clips, config, preprocessing(config), numbers, workers), save_every)


def _train_with_curves(folder: "TrainingFolder", steps: "Iterator[TrainingStep]", notify: Notify) -> float | None:
    """Go through all steps and draw the loss curves, also of an interrupted training. Returns the mean loss."""
    from ..training.loss_curves import write_loss_curves

    try:
        loss = _follow(steps, folder.record.settings.steps, notify)
    except BaseException:
        with suppress(Exception):  # the error that ended the training is reported, not one of the curves
            if log := folder.read_log():
                write_loss_curves(log, folder.path / CURVES_NAME)
        raise
    write_loss_curves(folder.read_log(), folder.path / CURVES_NAME)
    return loss


def _follow(steps: "Iterator[TrainingStep]", num_steps: int, notify: Notify) -> float | None:
    """Go through all steps, with a message every NOTIFY_EVERY steps. Returns the mean of the newest total losses."""
    recent: deque[float] = deque(maxlen=NOTIFY_EVERY)
    for step in steps:
        recent.append(step.losses["total"])
        if (step.number + 1) % NOTIFY_EVERY == 0:
            notify(f"step {step.number + 1} of {num_steps}: loss {sum(recent) / len(recent):.3f}")
    return sum(recent) / len(recent) if recent else None
