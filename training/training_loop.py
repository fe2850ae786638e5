"""Training loop: train on batches of clips, write the log, and save checkpoints."""

from collections.abc import Iterator
from itertools import islice

from .trainer import Trainer, TrainingStep
from .training_folder import TrainingFolder
from .training_frames import Clip


def train(trainer: Trainer, folder: TrainingFolder, clips: Iterator[Clip], save_every: int) -> Iterator[TrainingStep]:
    """Train from the trainer's current step to the last step, and yield every step.

    trainer: a new trainer, or one that `TrainingFolder.resume` restored.
    folder: the folder for the log, the checkpoint and the weights.
    clips: the remaining clips, in order.
    save_every: minimum number of steps between checkpoints. The state after the last step is always saved.

    Raises OutputError if a file cannot be written, and CheckError if a loss or gradient is not finite.
    """
    saved_step = trainer.step
    while batch := list(islice(clips, trainer.settings.batch_size)):
        steps = []
        for step in trainer.train_on(batch):
            steps.append(step)
            yield step
        folder.append_log(steps)
        # Only between batches: the history of a clip is not part of the checkpoint.
        if trainer.step - saved_step >= save_every or trainer.step == trainer.settings.steps:
            folder.save(trainer)
            saved_step = trainer.step
