"""A training in its folder: what it is, how far it came, and what it has learned so far."""

import json
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from itertools import islice
from pathlib import Path

import torch

from ..runtime.errors import ArtifactError, UsageError
from ..runtime.files import atomic_path, write_atomically
from ..weights import save_checkpoint
from .clips import Clip
from .settings import Settings
from .trainer import TrainingStep, Trainer

TRAINING_NAME = "training.json"
CHECKPOINT_NAME = "checkpoint.pt"
LOG_NAME = "log.jsonl"
WEIGHTS_NAME = "weights.safetensors"


@dataclass(frozen=True)
class TrainingRecord:
    """All that decides what is learned: the same again gives the same weights. `data`: what the drives are; `start`:
    the sha256 of the weights it begins with.
    """

    preset: str
    settings: Settings
    data: str
    start: str

    def to_dict(self) -> dict:
        return {**vars(self), "settings": self.settings.to_dict()}

    def metadata(self, step: int) -> dict[str, str]:
        """The provenance that weights of `step` carry in their file."""
        return {
            "trained": "false" if self.settings.pretraining else "true",  # of the whole model
            "preset": self.preset,
            "step": str(step),
            "steps": str(self.settings.steps),
            "seed": str(self.settings.seed),
            "data": self.data,
            "start": self.start,
            "settings": json.dumps(self.settings.to_dict()),
            "duospacenet": version("duospacenet"),
            "torch": torch.__version__,
            "commit": _commit(),
        }


class TrainingFolder:
    """`training.json`, `checkpoint.pt` with all of the state, `log.jsonl` with a line a step, and the weights."""

    def __init__(self, path: Path, training: TrainingRecord) -> None:
        self.path = path
        self.training = training

    def begin(self) -> None:
        """Raises OutputError where the folder cannot be written."""
        write_atomically(self.path / TRAINING_NAME, json.dumps(self.training.to_dict(), indent=2).encode())

    def check_record(self) -> None:
        """Raises UsageError where another training began here, ArtifactError where that cannot be read."""
        began = self._began()
        for name, asked in _flat(self.training.to_dict()).items():
            if began.get(name) != asked:
                raise UsageError(
                    f"--resume: {self.path / TRAINING_NAME}: the training began with {name} {began.get(name)!r}; "
                    f"got {asked!r}. Ask for the same, or choose another --out."
                )

    def _began(self) -> dict:
        path = self.path / TRAINING_NAME
        try:
            return _flat(dict(json.loads(path.read_bytes())))
        except (ValueError, TypeError, RecursionError) as error:
            raise ArtifactError(f"{path}: expected the JSON object of a training; got {error}") from error

    def resume(self, trainer: Trainer) -> None:
        """Bring `trainer` to the last checkpoint, and the log with it. Without a checkpoint, to the start.

        Raises ArtifactError for a checkpoint or a log that cannot be read.
        """
        path = self.path / CHECKPOINT_NAME
        if path.exists():
            try:
                trainer.load_state_dict(torch.load(path, map_location=trainer.device, weights_only=True))
            except Exception as error:
                raise ArtifactError(f"{path}: expected the state of this training; got {error}") from error
        lines = [line for line in self.log() if line["step"] < trainer.step]
        write_atomically(self.path / LOG_NAME, "".join(map(_line, lines)).encode())

    def record(self, steps: list[TrainingStep]) -> None:
        """Append steps to the log."""
        with (self.path / LOG_NAME).open("a", encoding="utf-8") as file:
            file.writelines(_line({"step": s.number, "gradient_norm": s.gradient_norm} | s.losses) for s in steps)

    def log(self) -> list[dict[str, float]]:
        """The steps so far, as they were recorded; a last line that was cut off is left out.

        Raises ArtifactError for a log that cannot be read.
        """
        path = self.path / LOG_NAME
        try:
            lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.exists() else []
            return [_read_line(line) for line in lines if line.endswith("\n")]
        except ValueError as error:
            raise ArtifactError(f"{path}: expected a JSON object a line; got {error}") from error

    def save(self, trainer: Trainer) -> None:
        """Keep the state and the weights, each whole or as they were.

        The state comes last: a training that is resumed at its end writes no weights any more.
        """
        with atomic_path(self.path / WEIGHTS_NAME) as temporary:
            save_checkpoint(temporary, trainer.model, self.training.metadata(trainer.step))
        with atomic_path(self.path / CHECKPOINT_NAME) as temporary:
            torch.save(trainer.state_dict(), temporary)


def train(trainer: Trainer, folder: TrainingFolder, drives: Iterator[Clip], save_every: int) -> Iterator[TrainingStep]:
    """Train to the end, from where `trainer` is; yields every step.

    The state is saved at the end, and between drives when `save_every` steps have passed: a drive's history is not
    part of it.
    """
    saved = trainer.step
    while group := list(islice(drives, trainer.settings.batch_size)):
        done = []
        for step in trainer.train_on(group):
            done.append(step)
            yield step
        folder.record(done)
        if trainer.step - saved >= save_every or trainer.step == trainer.settings.steps:
            folder.save(trainer)
            saved = trainer.step


def _commit() -> str:
    """Of the toolkit, where it lies in a repository of its own."""
    root = Path(__file__).resolve().parents[1]
    asking = ["git", "rev-parse", "--show-toplevel", "HEAD"]
    try:
        asked = subprocess.run(asking, cwd=root, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    top, commit = asked.stdout.splitlines()
    return commit if Path(top) == root else "unknown"


def _flat(training: dict) -> dict:
    return {name: value for name, value in training.items() if name != "settings"} | dict(training.get("settings", {}))


def _line(values: dict[str, float]) -> str:
    return json.dumps(values) + "\n"


def _read_line(line: str) -> dict[str, float]:
    """The inverse of `_line`. Raises ValueError."""
    values = json.loads(line)
    if not isinstance(values, dict) or not isinstance(values.get("step"), int):
        raise ValueError(f"a line without the number of its step: {line.strip()[:60]}")
    return values
