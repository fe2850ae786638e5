"""Talking to a person: results on stdout, progress and messages on stderr."""

import json
import resource
import sys
from collections.abc import Iterable, Iterator, Sized
from contextlib import suppress
from typing import Any, TypeVar

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

results = Console(highlight=False)
messages = Console(stderr=True, highlight=False)

Item = TypeVar("Item")


def show_progress(items: Iterable[Item], description: str, total: int | None = None) -> Iterator[Item]:
    """Pass items on, with a progress bar on stderr."""
    if total is None and isinstance(items, Sized):
        total = len(items)
    if not messages.is_terminal:
        say(f"{description} ...")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=messages, transient=True, disable=not messages.is_terminal) as progress:
        yield from progress.track(items, total=total, description=description)


def print_json(value: Any) -> None:
    """One JSON object on stdout."""
    sys.stdout.write(json.dumps(value, allow_nan=False) + "\n")


def peak_memory_gb() -> float:
    """The most memory that this process has held."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6


def say(message: str) -> None:
    """A message on stderr, as it is. A full disk behind stderr is no reason to stop."""
    with suppress(OSError):
        messages.print(message, markup=False, soft_wrap=True)
