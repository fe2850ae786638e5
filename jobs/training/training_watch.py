"""Watching a training: lines about its steps and validations, and its curves."""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

from ...runtime.errors import OutputError
from ...runtime.progress import describe_duration
from ..notify import Notify
from .training_start import CURVES_NAME, TENSORBOARD_NAME

if TYPE_CHECKING:
    from ...training import TrainingFolder
    from ...training.watching.step_report import StepReport
    from ...training.watching.validation_scores import ValidationScores

FIRST_LINES = (1, 3, 10, 30)  # after so many steps of this process; a line with an early loss shows a wrong start
LINE_EVERY = 100  # steps
MAX_WAITING_SHARE = 0.2  # a larger share of waiting for data is reported


def train_with_curves(folder: "TrainingFolder", reports: "Iterator[StepReport]", notify: Notify) -> float | None:
    """Go through all steps and draw the curves, also of an interrupted training.

    Returns the mean of the newest total losses; None if no step was left to do.
    """
    from ...training.watching.loss_curves import write_loss_curves

    try:
        loss = _follow(reports, folder.record.settings.steps, notify)
    except BaseException:
        with suppress(Exception):  # the error that ended the training is reported, not one of the curves
            if log := folder.log.steps():
                write_loss_curves(log, folder.read_validations(), folder.path / CURVES_NAME)
        raise
    write_loss_curves(folder.log.steps(), folder.read_validations(), folder.path / CURVES_NAME)
    return loss


def _follow(reports: "Iterator[StepReport]", num_steps: int, notify: Notify) -> float | None:
    """Go through all steps, with a line now and then. Returns the mean of the newest total losses."""
    recent: deque[float] = deque(maxlen=LINE_EVERY)
    for done, report in enumerate(reports, 1):
        recent.append(report.step.losses["total"])
        completed = report.step.number + 1
        if done in FIRST_LINES or completed % LINE_EVERY == 0 or completed == num_steps:
            notify(describe_step(report, num_steps, sum(recent) / len(recent)))
    return sum(recent) / len(recent) if recent else None


def describe_step(report: "StepReport", num_steps: int, loss: float) -> str:
    """One line about a step. loss: mean over the recent steps.

    For example "step 200 of 4000, epoch 1.25: loss 9.871, learning rate 4.0e-04, 0.52 s per step, 3.9 frames/s, 33 min
    left".
    """
    epoch = "" if report.epoch is None else f", epoch {report.epoch:.2f}"
    parts = [f"loss {loss:.3f}", f"learning rate {report.learning_rate:.1e}", f"{report.recent_step_s:.2f} s per step"]
    parts.append(f"{report.frames_per_s:.1f} frames/s")
    if report.gpu_memory_gb is not None:
        parts.append(f"{report.gpu_memory_gb:.1f} GB on the GPU")
    if report.waiting_share > MAX_WAITING_SHARE:
        parts.append(f"waiting for data {report.waiting_share:.0%} of the time (more --workers help)")
    parts.append(f"{describe_duration(report.remaining_s)} left")
    return f"step {report.step.number + 1} of {num_steps}{epoch}: {', '.join(parts)}"


def report_scores(notify: Notify) -> "Callable[[ValidationScores, bool], None]":
    """A function that tells the user the scores of a validation, and whether they are the best so far."""

    def report(scores: "ValidationScores", is_best: bool) -> None:
        best = f"; the best {scores.quality.name} so far" if is_best else ""
        notify(f"validation after step {scores.step}: {scores.describe()}{best}")

    return report


@contextmanager
def tensorboard_log(folder: "TrainingFolder", step: int) -> Iterator[None]:
    """Write TensorBoard logs for the duration of the block, after `step` completed steps. Needs the extra."""
    from ...training.watching.tensorboard_log import TensorBoardLog

    log = TensorBoardLog(folder.path / TENSORBOARD_NAME, step, folder.read_validations())
    folder.tensorboard = log
    try:
        yield
    except BaseException:
        with suppress(OutputError):  # the error that ended the training is reported, not one of the log
            log.close()
        raise
    log.close()
