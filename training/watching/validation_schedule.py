"""Validation schedule: when the model is validated, and which weights are the best so far."""

from collections.abc import Iterable

from .validation_scores import ValidationScores


class ValidationSchedule:
    """Says after which steps the model is validated, and whether the newest scores are the best.

    Both follow from the validations in the log, so that a resumed training decides as an uninterrupted one.
    """

    def __init__(self, every: int, data: str, earlier: Iterable[ValidationScores]) -> None:
        """every: steps between validations. data: as in `ValidationScores`. earlier: the scores in the log."""
        self.every = every
        self._scores = [scores for scores in earlier if scores.data == data]

    def is_due(self, step: int, num_steps: int) -> bool:
        """Whether the model is validated after `step` of `num_steps` steps.

        It is validated at the first end of a batch of clips at or after every multiple of `every`, and after the last
        step.
        """
        newest = self._scores[-1].step if self._scores else 0
        return step // self.every > newest // self.every or newest < step == num_steps

    def best(self) -> ValidationScores | None:
        """The best scores so far, of equal ones the earliest; None before the first validation."""
        return max(self._scores, key=lambda scores: scores.quality.value, default=None)

    def add(self, scores: ValidationScores) -> None:
        """Add the newest scores."""
        self._scores.append(scores)
