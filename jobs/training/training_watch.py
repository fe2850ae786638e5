"""Watching a training: messages about its steps, and its loss curves."""

from collections import deque
from collections.abc import Iterator
from contextlib import suppress
from typing import TYPE_CHECKING

from ..notify import Notify
from .training_start import CURVES_NAME

if TYPE_CHECKING:
    from ...training import TrainingFolder
    from ...training.trainer import TrainingStep

NOTIFY_EVERY = 100  # steps


def train_with_curves(folder: "TrainingFolder", steps: "Iterator[TrainingStep]", notify: Notify) -> float | None:
    """Go through all steps and draw the loss curves, also of an interrupted training. Returns the mean loss."""
    from ...training.loss_curves import write_loss_curves

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
