"""Step timer: measures the steps of a training and estimates the time that is left."""

import time
from collections import deque
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import torch

from ...runtime.peak_memory import peak_memory_gb
from ..trainer import Trainer, TrainingStep
from .step_report import StepReport

Item = TypeVar("Item")

RECENT_STEPS = 100  # rates and the time that is left are averaged over them


class _Duration(NamedTuple):
    step_s: float
    waiting_s: float
    num_frames: int


class StepTimer:
    """Measures the steps of one process.

    The time before the first step is not counted: the workers of the clip loader start then.
    """

    def __init__(self, trainer: Trainer, steps_per_epoch: float | None) -> None:
        """steps_per_epoch: steps of one pass over the sources; None if there is no end of them."""
        self._trainer = trainer
        self._steps_per_epoch = steps_per_epoch
        self._recent: deque[_Duration] = deque(maxlen=RECENT_STEPS)
        self._start_s: float | None = None  # of the current step
        self._waiting_s = 0.0  # of the current step

    def wait(self, load: Callable[[], Item]) -> Item:
        """Return the result of `load`. Its time counts as waiting for data."""
        begin_s = time.monotonic()
        loaded = load()
        now_s = time.monotonic()
        if self._start_s is None:
            self._start_s = now_s
        else:
            self._waiting_s += now_s - begin_s
        return loaded

    def pause(self, work: Callable[[], object]) -> None:
        """Call `work`. Its time is not counted."""
        begin_s = time.monotonic()
        work()
        if self._start_s is not None:
            self._start_s += time.monotonic() - begin_s

    def report(self, step: TrainingStep) -> StepReport:
        """The report of a step that has just ended."""
        assert self._start_s is not None
        now_s = time.monotonic()
        self._recent.append(_Duration(now_s - self._start_s, self._waiting_s, step.num_frames))
        self._start_s, self._waiting_s = now_s, 0.0
        elapsed_s = max(sum(duration.step_s for duration in self._recent), 1e-9)
        backbone, others = self._trainer.optimiser.param_groups[:2]
        completed, device = step.number + 1, self._trainer.device
        return StepReport(
            step=step,
            epoch=None if self._steps_per_epoch is None else completed / self._steps_per_epoch,
            learning_rate=others["lr"],
            backbone_learning_rate=backbone["lr"],
            step_s=self._recent[-1].step_s,
            waiting_s=self._recent[-1].waiting_s,
            recent_step_s=elapsed_s / len(self._recent),
            waiting_share=sum(duration.waiting_s for duration in self._recent) / elapsed_s,
            frames_per_s=sum(duration.num_frames for duration in self._recent) / elapsed_s,
            remaining_s=(self._trainer.settings.steps - completed) * elapsed_s / len(self._recent),
            memory_gb=peak_memory_gb(),
            gpu_memory_gb=torch.cuda.max_memory_allocated(device) / 1e9 if device.type == "cuda" else None,
        )
