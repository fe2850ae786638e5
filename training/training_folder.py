"""Training folder: the record, the checkpoint, the log and the weights of one training run."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from ..runtime.errors import ArtifactError
from ..runtime.files import atomic_path, write_atomically
from ..runtime.strict_json import parse_strict_json
from ..weights import save_checkpoint
from .hash_trailer import append_hash, check_hash
from .trainer import Trainer
from .training_record import TrainingRecord, flatten_record
from .watching.step_report import StepReport
from .watching.training_log import TrainingLog
from .watching.validation_scores import ValidationScores

if TYPE_CHECKING:
    from .watching.tensorboard_log import TensorBoardLog

TRAINING_NAME = "training.json"
CHECKPOINT_NAME = "checkpoint.pt"
LOG_NAME = "log.jsonl"
WEIGHTS_NAME = "weights.safetensors"
BEST_NAME = "best.safetensors"


class TrainingFolder:
    """The files of one training run.

    `training.json`: the training record.
    `checkpoint.pt`: the full training state, to resume from, and its sha256.
    `log.jsonl`: one JSON object per step and per validation, see `TrainingLog`.
    `weights.safetensors`: the newest weights, with their provenance and the model's configuration as metadata.
    `best.safetensors`: with validation, the weights with the best scores so far, with the same metadata and the scores.

    tensorboard: the TensorBoard log that gets the lines of the log as well; None for none.
    """

    tensorboard: "TensorBoardLog | None" = None

    def __init__(self, path: Path, record: TrainingRecord) -> None:
        self.path = path
        self.record = record
        self.log = TrainingLog(path / LOG_NAME)

    def write_record(self) -> None:
        """Write the training record. Raises OutputError if the folder cannot be written."""
        write_atomically(self.path / TRAINING_NAME, json.dumps(self.record.to_dict(), indent=2).encode())

    def read_record(self) -> dict[str, Any]:
        """The record in the folder as one flat dictionary, see `flatten_record`.

        Raises ArtifactError if it cannot be read.
        """
        path = self.path / TRAINING_NAME
        try:
            return flatten_record(dict(parse_strict_json(path.read_bytes())))
        except (ValueError, TypeError, RecursionError) as error:
            raise ArtifactError(f"{path}: expected the JSON object of a training run; got {error}") from error

    def resume(self, trainer: Trainer) -> None:
        """Load the checkpoint into `trainer`, and remove later steps and validations from the log.

        Without a checkpoint, `trainer` is unchanged and the log is emptied.

        Raises ArtifactError if the checkpoint or the log cannot be read.
        """
        self.load(trainer)
        self.log.cut(trainer.step)

    def load(self, trainer: Trainer) -> None:
        """Load the checkpoint, if there is one, into `trainer`. Raises ArtifactError if it cannot be read."""
        path = self.path / CHECKPOINT_NAME
        if path.exists():
            _load_state(path, trainer)

    def append_steps(self, reports: Sequence[StepReport]) -> None:
        """Append steps to the log. Raises OutputError if it cannot be written."""
        self.log.append(report.to_dict() for report in reports)
        if self.tensorboard is not None:
            for report in reports:
                self.tensorboard.add_step(report)

    def append_validation(self, scores: ValidationScores) -> None:
        """Append a validation to the log. Raises OutputError if it cannot be written."""
        self.log.append([scores.to_dict()])
        if self.tensorboard is not None:
            self.tensorboard.add_validation(scores)

    def read_validations(self) -> list[ValidationScores]:
        """The validations in the log. Raises ArtifactError if they cannot be read."""
        try:
            return [ValidationScores.from_dict(line) for line in self.log.validations()]
        except ValueError as error:
            raise ArtifactError(
                f"{self.log.path}: expected scores in each line of a validation; got {error}"
            ) from error

    def save(self, trainer: Trainer) -> None:
        """Write the weights and the checkpoint. Each file is replaced atomically. Raises OutputError."""
        if self.tensorboard is not None:
            self.tensorboard.flush()  # before the checkpoint, so that a resumed training lacks no event
        self._save_weights(WEIGHTS_NAME, trainer, {})
        # The checkpoint is written last, because a run that resumes from its final checkpoint writes no weights.
        with atomic_path(self.path / CHECKPOINT_NAME) as temporary:
            torch.save(trainer.state_dict(), temporary)
            append_hash(temporary)

    def save_best(self, trainer: Trainer, scores: ValidationScores) -> None:
        """Write the weights as the best so far. The file is replaced atomically. Raises OutputError."""
        validation = {**scores.to_dict()["validation"], "best_by": scores.quality.name}
        self._save_weights(BEST_NAME, trainer, {"validation": json.dumps(validation)})

    def _save_weights(self, name: str, trainer: Trainer, metadata: dict[str, str]) -> None:
        with atomic_path(self.path / name) as temporary:
            save_checkpoint(temporary, trainer.evaluated_model, self.record.metadata(trainer.step) | metadata)


def _load_state(path: Path, trainer: Trainer) -> None:
    """Load a checkpoint into `trainer`. Raises ArtifactError for a damaged file, or the state of another model."""
    try:
        with path.open("rb") as file:
            check_hash(file)
            trainer.load_state_dict(torch.load(file, map_location=trainer.device, weights_only=True))
    except Exception as error:
        raise ArtifactError(
            f"{path}: expected the state of this training run; got {error}. Restore the file from a copy, or start a "
            f"new training in another --out. --weights {path.with_name(WEIGHTS_NAME)} continues from its weights."
        ) from error
