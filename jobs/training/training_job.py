"""Training in a folder, which holds the weights, the training state, the log and the loss curves. It can be resumed."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...runtime.extras import needs_extra
from ...runtime.progress import Progress, no_progress
from ..folder_lock import lock_folder
from ..models import check_checkpoint_options, optional_path, preset_or_config
from ..notify import Notify
from ..notify import ignore as ignore_message
from ..output_folder import make_folders
from ..sources import SourceNames
from .held_out_sources import check_validation_options, open_held_out_sources
from .initial_model import initial_model
from .memory_report import describe_memory
from .training_data import check_first_clip, open_training_data
from .training_processes import check_parts, join_training_processes
from .training_start import begin_or_resume, check_training_folder, read_extensions
from .training_watch import tensorboard_log, train_with_curves

if TYPE_CHECKING:
    from ...model import DuoSpaceNet, DuoSpaceNetConfig
    from ...training import Settings, Trainer, TrainingFolder
    from ...training.distributed import Processes
    from ...training.samples.clips import Clips
    from ...training.watching.step_report import StepReport
    from ...training.watching.validator import Validator


@dataclass(frozen=True)
class TrainingSummary:
    """The result of a training. loss: mean of the newest total losses; None if no step was left to do."""

    weights: Path
    steps: int
    loss: float | None

    def to_dict(self) -> dict[str, Any]:
        """The fields as JSON values."""
        return {**vars(self), "weights": str(self.weights)}


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
    anchors: str | Path | None = None,
    device: str = "auto",
    workers: int = 1,
    accumulation_steps: int = 1,
    activation_checkpointing: bool = False,
    save_every: int = 200,
    validation: SourceNames | None = None,
    validate_every: int | None = None,
    tensorboard: bool = False,
    resume: bool = False,
    progress: Progress = no_progress,
    step_progress: Progress = no_progress,
    notify: Notify = ignore_message,
) -> TrainingSummary:
    """Train a model, and keep its weights, its state, its log and its loss curves in the folder `out`.

    sources: one or several sources with ground truth; None trains on new synthetic scenes. A clip never spans two
        sources.
    weights: a checkpoint to start from; None starts from a random initialisation.
    allow_missing: patterns of further tensors that the checkpoint may lack, see `load_start`.
    ignore: patterns of tensors in the checkpoint that are not loaded.
    weights_key: the key of the weights in the checkpoint, if it holds several copies.
    anchors: a file with the initial queries, see `place_queries`; None clusters them from the ground truth.
    device: "auto", "cpu", "cuda" or "cuda:N".
    workers: processes that prepare the next clips, for each process of the training.
    accumulation_steps: parts in which each process computes its frames of a step, one after the other.
    activation_checkpointing: compute activations again in the backward pass, which needs less memory.
    save_every: steps between checkpoints.
    validation: one or several held-out sources with ground truth. `out` then has the best weights as well.
    validate_every: steps between validations; None = VALIDATE_EVERY.
    tensorboard: write TensorBoard logs as well.
    resume: continue from the last checkpoint in `out`. `settings` may have more steps than before, see `Extension`.
    progress: of opening sources.
    step_progress: of the steps and of validations, beside the lines that `notify` gets.

    Under torchrun, each process trains on its part of the batch, and the first one writes all files and messages.

    Raises a DuoSpaceNetError before anything is written if an argument or the folder is not valid.
    Raises InputError for a frame without the ground truth that is needed.
    """
    _check_extras(tensorboard)
    from ...training import TrainingFolder, TrainingRecord
    from ...training.training_folder import WEIGHTS_NAME
    from ...weights.provenance import hash_weights

    out, weights = Path(out), optional_path(weights)
    config = preset_or_config(config)
    check_checkpoint_options(weights, allow_missing, ignore, weights_key)
    selection = {"allow_missing": allow_missing, "ignore": ignore, "weights_key": weights_key}
    check_validation_options(validation, validate_every, settings)
    with ExitStack() as stack:
        processes = stack.enter_context(join_training_processes(device))
        check_parts(settings, processes, accumulation_steps)
        if processes.is_first:
            check_training_folder(out, resume)
        else:  # only the first process writes messages and files
            progress, step_progress, notify, validation = no_progress, no_progress, ignore_message, None
        data = open_training_data(sources, settings, config, progress, notify)
        check_first_clip(data, config)
        held_out = open_held_out_sources(validation, config, data, progress, notify)
        model, parts = initial_model(
            config, data.settings, data.anchor_truth, weights, selection, notify, optional_path(anchors)
        )
        trainer = _make_trainer(model, data.settings, processes, accumulation_steps, activation_checkpointing, notify)
        record = TrainingRecord(config, data.settings, data.clips.identity, hash_weights(model), trained_before=parts)
        folder = TrainingFolder(out, record)
        if not processes.is_first:
            return _follow(folder, trainer, data.clips, workers)
        make_folders(out, ("",))
        stack.enter_context(lock_folder(out, notify))
        check_training_folder(out, resume)  # again: another training may have written here before the lock
        begin_or_resume(folder, trainer, resume, notify)
        processes.wait()
        validator = None if held_out is None else held_out.validator(folder, validate_every, step_progress, notify)
        if tensorboard:
            stack.enter_context(tensorboard_log(folder, trainer.step))
        reports = _train(folder, trainer, data.clips, validator, workers, save_every)
        num_steps = data.settings.steps
        shown = step_progress(reports, f"training {config.preset}", num_steps, done=trainer.step)
        return TrainingSummary(out / WEIGHTS_NAME, num_steps, train_with_curves(folder, shown, notify))


def _check_extras(tensorboard: bool) -> None:
    """Raise MissingExtraError, before anything is written, if a package is not installed."""
    with needs_extra("train"):
        from ...training import train  # noqa: F401
    with needs_extra("viz"):
        from ...training.watching import loss_curves  # noqa: F401
    if tensorboard:
        with needs_extra("tensorboard"):
            from ...training.watching import tensorboard_log  # noqa: F401


def _make_trainer(
    model: "DuoSpaceNet",
    settings: "Settings",
    processes: "Processes",
    accumulation_steps: int,
    activation_checkpointing: bool,
    notify: Notify,
) -> "Trainer":
    """The trainer of a model. Reports the memory that the training needs."""
    from ...training import Trainer
    from ...training.activation_checkpointing import checkpoint_activations

    memory = (processes.count, accumulation_steps, activation_checkpointing)
    if processes.is_first and (message := describe_memory(model.config, settings, *memory)):
        notify(message)
    if activation_checkpointing:
        checkpoint_activations(model)
    return Trainer(model, settings, processes, accumulation_steps)


def _follow(folder: "TrainingFolder", trainer: "Trainer", clips: "Clips", workers: int) -> TrainingSummary:
    """Train with the first process, and write nothing."""
    trainer.processes.wait()  # for the first process, which checks the folder and prepares it
    folder.load(trainer)
    read_extensions(folder)
    for _ in _train(folder, trainer, clips, None, workers, trainer.settings.steps):
        pass
    return TrainingSummary(folder.path, trainer.settings.steps, None)


def _train(
    folder: "TrainingFolder",
    trainer: "Trainer",
    clips: "Clips",
    validator: "Validator | None",
    workers: int,
    save_every: int,
) -> "Iterator[StepReport]":
    """Train to the end. Yields a report of every step."""
    from ...training import train
    from ...training.samples.batches import make_batches
    from ...training.samples.clip_loader import clips_of_process, load_clips, remaining_clips
    from ...weights.input_contract import preprocessing

    settings, config, samples = trainer.settings, trainer.model.config, clips.samples_per_epoch
    processes, on_gpu = trainer.processes, trainer.device.type == "cuda"
    restarts = [extension.at_step for extension in folder.record.extended]
    numbers = remaining_clips(clips, settings, trainer.step, restarts)
    own = clips_of_process(numbers, settings, processes.rank, processes.count)
    loaded = load_clips(clips, config, preprocessing(config), own, workers, settings, pin_memory=on_gpu)
    batches = make_batches(loaded, clips, numbers, settings, processes.count)
    steps_per_epoch = None if samples is None else samples / settings.batch_size
    return train(trainer, folder, batches, save_every, validator, steps_per_epoch)
