"""TensorBoard log: the losses, learning rates and scores of a training as curves. Needs the extra `tensorboard`."""

import threading
from collections.abc import Iterable, Mapping
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from ...runtime.files import output_errors
from .step_report import StepReport
from .validation_scores import ValidationScores


class TensorBoardLog:
    """Writes event files. A step has its number, counted from 0; a validation has the number of completed steps."""

    def __init__(self, folder: Path, step: int, validations: Iterable[ValidationScores]) -> None:
        """Continue the curves after `step` completed steps. TensorBoard removes what was written for later steps.

        validations: the validations until then. One after exactly `step` steps is written again, since its event is
            among those that TensorBoard removes.
        Raises OutputError if the folder cannot be written.
        """
        self._folder = folder
        self._excepthook = threading.excepthook
        threading.excepthook = self._ignore_output_errors
        with output_errors(folder):
            self._writer = SummaryWriter(str(folder), purge_step=step)
        for scores in validations:
            if scores.step == step:
                self.add_validation(scores)

    def add_step(self, report: StepReport) -> None:
        """Add a step: its losses, gradient norm, learning rates and speed. Raises OutputError."""
        step = report.step
        values: dict[str, float | None] = {f"loss/{name}": value for name, value in step.losses.items()}
        values["learning_rate/backbone"] = report.backbone_learning_rate
        values["learning_rate/others"] = report.learning_rate
        values["step/gradient_norm"] = step.gradient_norm
        values["step/frames_per_s"] = report.frames_per_s
        self._add(values, step.number)

    def add_validation(self, scores: ValidationScores) -> None:
        """Add the scores of a validation. Raises OutputError."""
        self._add({f"validation/{name}": value for name, value in scores.scores().items()}, scores.step)

    def flush(self) -> None:
        """Write everything to disk, before a checkpoint from which the curves would continue. Raises OutputError."""
        with output_errors(self._folder):
            self._writer.flush()

    def close(self) -> None:
        """Write everything to disk and end. Raises OutputError."""
        try:
            with output_errors(self._folder):
                self._writer.close()
        finally:
            threading.excepthook = self._excepthook

    def _add(self, values: Mapping[str, float | None], step: int) -> None:
        """Add one point to each curve; none for an unknown value."""
        with output_errors(self._folder):
            for name, value in values.items():
                if value is not None:
                    self._writer.add_scalar(name, value, step)

    def _ignore_output_errors(self, arguments: threading.ExceptHookArgs) -> None:
        """Print no traceback of an OSError in the thread that writes. The next call of the writer raises it again."""
        if not issubclass(arguments.exc_type, OSError):
            self._excepthook(arguments)
