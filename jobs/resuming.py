"""Resuming: an interrupted job continues only with the settings that it began with."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..runtime.errors import UsageError


def check_same_settings(
    job: str, record: Path, recorded: Mapping[str, Any], requested: Mapping[str, Any], alternative: str
) -> None:
    """Compare the settings of a resumed job with the recorded ones.

    job: "run" or "training", for the message.
    record: the file with the recorded settings.
    alternative: what the user can do instead of using the same settings.
    Raises UsageError that names the first setting that differs.
    """
    for name, value in requested.items():
        if recorded.get(name) != value:
            raise UsageError(
                f"--resume: {record}: the {job} began with {name} {recorded.get(name)!r}; got {value!r}. "
                f"Use the same settings, or {alternative}."
            )
