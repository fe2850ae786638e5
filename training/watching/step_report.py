"""Step report: the result of an optimiser step, with its learning rates and the time that it took."""

from dataclasses import dataclass
from typing import Any

from ..trainer import TrainingStep

# The fields of the log that differ between two runs of the same training.
MEASURED = ("step_s", "waiting_s", "frames_per_s", "remaining_s", "memory_gb", "gpu_memory_gb")
NOT_LOSSES = ("step", "epoch", "learning_rate", "backbone_learning_rate", "gradient_norm", *MEASURED)


@dataclass(frozen=True)
class StepReport:
    """The result of one optimiser step, and the time that it took.

    epoch: passes over the sources after this step; None for the endless synthetic drives.
    learning_rate, backbone_learning_rate: the rates that the step used.
    step_s: duration of the step with the time that it waited for data [s].
    waiting_s: the time that it waited for data [s].
    recent_step_s: mean duration of the recent steps [s].
    waiting_share: the share of their time that the recent steps waited for data, 0 to 1.
    frames_per_s: frames per second of the recent steps.
    remaining_s: estimated duration of the remaining steps [s].
    memory_gb: peak memory of this process, without workers [GB].
    gpu_memory_gb: peak memory that torch used on the GPU [GB]; None without a GPU.
    """

    step: TrainingStep
    epoch: float | None
    learning_rate: float
    backbone_learning_rate: float
    step_s: float
    waiting_s: float
    recent_step_s: float
    waiting_share: float
    frames_per_s: float
    remaining_s: float
    memory_gb: float
    gpu_memory_gb: float | None

    def to_dict(self) -> dict[str, float | None]:
        """The line of the log, see `NOT_LOSSES`; all other fields are losses. Unknown values are left out."""
        step = self.step
        line: dict[str, float | None] = {"step": step.number, "epoch": self.epoch, "learning_rate": self.learning_rate}
        line |= {"backbone_learning_rate": self.backbone_learning_rate, "gradient_norm": step.gradient_norm}
        line |= step.losses
        measured: dict[str, Any] = {name: getattr(self, name) for name in MEASURED}
        line |= {name: None if value is None else round(value, 4) for name, value in measured.items()}
        return {name: value for name, value in line.items() if value is not None}
