"""Training record: everything that determines the weights of a training run."""

import json
import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from ..model import DuoSpaceNetConfig
from ..runtime.versions import library_versions
from ..weights.trained_parts import NO_ANCHORS, IsTrained, parts_metadata, trained_parts
from .settings import Settings
from .tasks import trained_tasks, unchanged_parts


class Extension(NamedTuple):
    """An extension of a training to more steps.

    at_step: completed steps at that time. The earlier steps used the learning rates of a training of `old_steps` steps,
        the later ones those of a training of `new_steps` steps.
    """

    at_step: int
    old_steps: int
    new_steps: int


@dataclass(frozen=True)
class TrainingRecord:
    """Everything that determines the resulting weights: two training runs with equal records produce equal weights.

    config: the configuration of the model.
    settings: the training settings.
    data: the `identity` of the clips.
    start: the sha256 of the weights before the first step.
    trained_before: the parts of the model that were trained before the first step, see `weights.trained_parts`; parts
        that are not in it were not.
    extended: every time that the training was extended, in order. `settings.steps` is the newest number of steps.
    """

    config: DuoSpaceNetConfig
    settings: Settings
    data: str
    start: str
    trained_before: IsTrained = field(default_factory=dict)
    extended: tuple[Extension, ...] = ()

    def to_dict(self) -> dict:
        """The record as plain JSON values."""
        fields = {"preset": self.config.preset, "data": self.data, "start": self.start}
        return (
            fields
            | {"extended": self._extended()}
            | {"settings": self.settings.to_dict(), "config": self.config.to_dict()}
        )

    def metadata(self, step: int) -> dict[str, str]:
        """The provenance that is stored in the weights file after `step` steps."""
        return {
            **parts_metadata(trained_parts(self.trained_before, self.config, self._unchanged_parts())),
            **self._anchors_metadata(),
            "preset": self.config.preset,
            "config": json.dumps(self.config.to_dict()),
            "step": str(step),
            "steps": str(self.settings.steps),
            "seed": str(self.settings.seed),
            "data": self.data,
            "start": self.start,
            "settings": json.dumps(self.settings.to_dict()),
            **({"extended": json.dumps(self._extended())} if self.extended else {}),
            **library_versions(("duospacenet", "torch")),
            "commit": _commit(),
        }

    def _unchanged_parts(self) -> set[str]:
        return unchanged_parts(self.settings, self.config)

    def _anchors_metadata(self) -> dict[str, str]:
        """Say if the queries are at random positions, because only maps were trained, from random weights."""
        is_trained = trained_tasks(self.settings, self.config).detection
        return {} if is_trained or self.trained_before.get("queries", False) is not False else NO_ANCHORS

    def _extended(self) -> list[dict[str, int]]:
        return [extension._asdict() for extension in self.extended]


def flatten_record(record: dict[str, Any]) -> dict[str, Any]:
    """The fields of a record, of its settings and of its configuration (as `config.NAME`) in one dictionary."""
    fields = {name: value for name, value in record.items() if name not in ("settings", "config")}
    config = {f"config.{name}": value for name, value in dict(record.get("config", {})).items()}
    return fields | dict(record.get("settings", {})) | config


def _commit() -> str:
    """The commit of the toolkit, or "unknown" if its folder is not the root of a git repository."""
    root = Path(__file__).resolve().parents[1]
    command = ["git", "rev-parse", "--show-toplevel", "HEAD"]
    try:
        result = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    top, commit = result.stdout.splitlines()
    return commit if Path(top) == root else "unknown"
