"""Training loop: train on batches of clips, write the log, save checkpoints, and validate."""

from collections.abc import Iterator

from .samples.batches import Batch
from .samples.clip_loader import lost_workers_reported
from .trainer import Trainer
from .training_folder import TrainingFolder
from .watching.step_report import StepReport
from .watching.step_timer import StepTimer
from .watching.validator import Validator


def train(
    trainer: Trainer,
    folder: TrainingFolder,
    batches: Iterator[Batch],
    save_every: int,
    validator: Validator | None = None,
    steps_per_epoch: float | None = None,
) -> Iterator[StepReport]:
    """Train from the trainer's current step to the last step, and yield a report of every step.

    trainer: a new trainer, or one that `TrainingFolder.resume` restored.
    folder: the folder for the log, the checkpoint and the weights.
    batches: the remaining batches of this process, in order.
    save_every: minimum number of steps between checkpoints. The state after the last step, and before each validation,
        is always saved.
    validator: validates the model, see `ValidationSchedule`; None for no validation.
    steps_per_epoch: for the epoch in the log; None if the clips have no epochs.

    Of several processes, only the first one writes files.

    Raises OutputError if a file cannot be written, CheckError if a loss or gradient is not finite, and LostProcessError
    if a worker that loads clips was killed.
    """
    timer = StepTimer(trainer, steps_per_epoch)
    writes_files = trainer.processes.is_first
    saved_step = trainer.step
    if validator is not None and validator.is_due(trainer):
        validator.validate(trainer, folder)  # the training was interrupted after the checkpoint
    with lost_workers_reported():
        while batch := timer.wait(lambda: next(batches, None)):
            reports = []
            for step in trainer.train_on(batch.clips, batch.num_steps):
                reports.append(timer.report(step))
                yield reports[-1]
            if not writes_files:
                continue
            folder.append_steps(reports)
            # Only between batches: the history of a clip is not part of the checkpoint.
            is_validated = validator is not None and validator.is_due(trainer)
            if is_validated or trainer.step - saved_step >= save_every or trainer.step == trainer.settings.steps:
                timer.pause(lambda: folder.save(trainer))
                saved_step = trainer.step
            if validator is not None and is_validated:
                timer.pause(lambda: validator.validate(trainer, folder))
