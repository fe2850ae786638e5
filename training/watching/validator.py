"""Validator: validates a model in training on held-out sources, and keeps the best weights."""

import copy
from collections.abc import Callable

from ...evaluation import EvaluationReport
from ...model import DuoSpaceNet
from ..trainer import Trainer
from ..training_folder import TrainingFolder
from .validation_schedule import ValidationSchedule
from .validation_scores import ValidationScores

Evaluate = Callable[[DuoSpaceNet], EvaluationReport]


class Validator:
    """Validates a copy of the model, so that the training gives the same weights as without validation."""

    def __init__(
        self,
        evaluate: Evaluate,
        data: str,
        schedule: ValidationSchedule,
        on_scores: Callable[[ValidationScores, bool], None] = lambda scores, is_best: None,
    ) -> None:
        """evaluate: evaluates a model in evaluation mode, on the device of the training.
        data: the identities of the sources that it uses.
        schedule: with the earlier validations of this training.
        on_scores: called with the scores of each validation, and whether they are the best so far.
        """
        self._evaluate = evaluate
        self._data = data
        self._schedule = schedule
        self._on_scores = on_scores

    def is_due(self, trainer: Trainer) -> bool:
        """Whether the model is validated after the trainer's completed steps, see `ValidationSchedule`."""
        return self._schedule.is_due(trainer.step, trainer.settings.steps)

    def validate(self, trainer: Trainer, folder: TrainingFolder) -> None:
        """Validate the model, add the scores to the log, and save the weights if they are the best so far.

        The checkpoint of this step must have been saved. If the training is interrupted here, it is resumed from
        there, and validates again.

        Raises InputError for a frame that the model cannot process, and OutputError if a file cannot be written.
        """
        report = self._evaluate(copy.deepcopy(trainer.evaluated_model).eval())
        scores = ValidationScores.of_report(trainer.step, self._data, report)
        best = self._schedule.best()
        is_best = best is None or scores.quality.value > best.quality.value
        if is_best:
            folder.save_best(trainer, scores)
        # The log comes last: without its line, the validation is repeated after an interruption.
        folder.append_validation(scores)
        self._schedule.add(scores)
        self._on_scores(scores, is_best)
