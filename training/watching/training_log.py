"""Training log: a file with one JSON object per line, for each step and for each validation."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ...runtime.errors import ArtifactError
from ...runtime.files import output_errors, write_atomically

VALIDATION = "validation"  # only lines of validations have this field

Line = dict[str, Any]


class TrainingLog:
    """The log of a training, `log.jsonl`.

    The line of a step has the number of the step, counted from 0, as `step`, and the fields of `StepReport.to_dict`.
    The line of a validation has the number of completed steps as `step`, and its scores as `validation`. It follows the
    line of the last completed step.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def append(self, lines: Iterable[Mapping[str, Any]]) -> None:
        """Append lines. Raises OutputError if the file cannot be written."""
        with output_errors(self.path), self.path.open("a", encoding="utf-8") as file:
            file.writelines(map(_format_line, lines))

    def steps(self) -> list[Line]:
        """The lines of the steps. Raises ArtifactError if the file cannot be read."""
        return [line for line in self._read() if VALIDATION not in line]

    def validations(self) -> list[Line]:
        """The lines of the validations. Raises ArtifactError if the file cannot be read."""
        return [line for line in self._read() if VALIDATION in line]

    def cut(self, step: int) -> None:
        """Keep only the lines until `step` completed steps.

        Raises ArtifactError if the file cannot be read, OutputError if it cannot be written.
        """
        lines = [line for line in self._read() if line["step"] < step + (VALIDATION in line)]
        write_atomically(self.path, "".join(map(_format_line, lines)).encode())

    def _read(self) -> list[Line]:
        """All lines. An incomplete last line is left out."""
        try:
            lines = self.path.read_text(encoding="utf-8").splitlines(keepends=True) if self.path.exists() else []
            return [_parse_line(line) for line in lines if line.endswith("\n")]
        except ValueError as error:
            raise ArtifactError(f"{self.path}: expected one JSON object per line; got {error}") from error


def _format_line(values: Mapping[str, Any]) -> str:
    return json.dumps(values, allow_nan=False) + "\n"


def _parse_line(line: str) -> Line:
    """The inverse of `_format_line`. Raises ValueError."""
    values = json.loads(line)
    if not isinstance(values, dict) or not isinstance(values.get("step"), int):
        raise ValueError(f"a line without a step number: {line.strip()[:60]}")
    if not isinstance(values.get(VALIDATION, {}), dict):
        raise ValueError(f"a validation without scores: {line.strip()[:60]}")
    return values
