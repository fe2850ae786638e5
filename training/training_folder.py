"""Training folder: the record, the checkpoint, the log and the weights of one training run."""

import json
from pathlib import Path
from typing import Any

import torch

from ..runtime.errors import ArtifactError
from ..runtime.files import atomic_path, write_atomically
from ..runtime.strict_json import parse_strict_json
from ..weights import save_checkpoint
from .hash_trailer import append_hash, check_hash
from .trainer import Trainer, TrainingStep
from .training_record import TrainingRecord, flatten_record

TRAINING_NAME = "training.json"
CHECKPOINT_NAME = "checkpoint.pt"
LOG_NAME = "log.jsonl"
WEIGHTS_NAME = "weights.safetensors"


class TrainingFolder:
    """The files of one training run.

    `training.json`: the training record.
    `checkpoint.pt`: the full training state, to resume from, and its sha256.
    `log.jsonl`: one JSON object per step, with its losses.
    `weights.safetensors`: the weights, with their provenance and the model's configuration as metadata.
    """

    def __init__(self, path: Path, record: TrainingRecord) -> None:
        self.path = path
        self.record = record

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
        """Load the checkpoint into `trainer`, and remove later steps from the log.

        Without a checkpoint, `trainer` is unchanged and the log is emptied.

        Raises ArtifactError if the checkpoint or the log cannot be read.
        """
        path = self.path / CHECKPOINT_NAME
        if path.exists():
            _load_state(path, trainer)
        lines = [line for line in self.read_log() if line["step"] < trainer.step]
        write_atomically(self.path / LOG_NAME, "".join(map(_format_line, lines)).encode())

    def append_log(self, steps: list[TrainingStep]) -> None:
        """Append steps to the log."""
        lines = ({"step": step.number, "gradient_norm": step.gradient_norm} | step.losses for step in steps)
        with (self.path / LOG_NAME).open("a", encoding="utf-8") as file:
            file.writelines(map(_format_line, lines))

    def read_log(self) -> list[dict[str, float]]:
        """The logged steps. An incomplete last line is left out.

        Raises ArtifactError if the log cannot be read.
        """
        path = self.path / LOG_NAME
        try:
            lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.exists() else []
            return [_parse_line(line) for line in lines if line.endswith("\n")]
        except ValueError as error:
            raise ArtifactError(f"{path}: expected one JSON object per line; got {error}") from error

    def save(self, trainer: Trainer) -> None:
        """Write the weights and the checkpoint. Each file is replaced atomically."""
        with atomic_path(self.path / WEIGHTS_NAME) as temporary:
            save_checkpoint(temporary, trainer.model, self.record.metadata(trainer.step))
        # The checkpoint is written last, because a run that resumes from its final checkpoint writes no weights.
        with atomic_path(self.path / CHECKPOINT_NAME) as temporary:
            torch.save(trainer.state_dict(), temporary)
            append_hash(temporary)


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


def _format_line(values: dict[str, float]) -> str:
    return json.dumps(values) + "\n"


def _parse_line(line: str) -> dict[str, float]:
    """The inverse of `_format_line`. Raises ValueError."""
    values = json.loads(line)
    if not isinstance(values, dict) or not isinstance(values.get("step"), int):
        raise ValueError(f"a line without a step number: {line.strip()[:60]}")
    return values
