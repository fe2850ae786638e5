"""Output of the commands: results on stdout; progress and messages on stderr.

Text from files and paths may contain control characters. They are printed as escapes, and never reach the terminal.

rich is imported when something is printed, so that `--help` does not wait for it.
"""

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Any, TypeVar

from ..runtime.printable import printable

if TYPE_CHECKING:
    from rich.console import Console, RenderableType

Item = TypeVar("Item")


def print_result(content: "RenderableType", markup: bool = True, soft_wrap: bool = False) -> None:
    """Print text or a table on stdout.

    markup: read rich's markup in text; pass False for text that contains paths or other input.
    soft_wrap: let the terminal wrap long lines, so that a copied line is whole.
    """
    _stdout_console().print(content, markup=markup, soft_wrap=soft_wrap)


def print_json(value: Any) -> None:
    """Print one JSON object on stdout, on one line of ASCII."""
    text = json.dumps(value, allow_nan=False)
    sys.stdout.write(text.replace("\x7f", "\\u007f") + "\n")  # json escapes all other control characters itself


def print_message(message: str) -> None:
    """Print a message on stderr. A message that cannot be written is dropped, e.g. on a full disk."""
    with suppress(OSError):
        _stderr_console().print(message, markup=False, soft_wrap=True)


def show_progress(
    items: Iterable[Item],
    description: str,
    total: int | None = None,
    *,
    done: int = 0,
    label: Callable[[Item], str] | None = None,
) -> Iterator[Item]:
    """Pass items on and show a progress bar on stderr, or a line of text now and then if stderr is not a terminal."""
    from .progress_display import display_progress

    yield from display_progress(_stderr_console(), items, description, total, done, label, print_message)


def show_bar(
    items: Iterable[Item],
    description: str,
    total: int | None = None,
    *,
    done: int = 0,
    label: Callable[[Item], str] | None = None,
) -> Iterator[Item]:
    """Pass items on and show a progress bar if stderr is a terminal. For work that prints its own lines."""
    if _stderr_console().is_terminal:
        yield from show_progress(items, description, total, done=done, label=label)
    else:
        yield from items


def print_error(message: str) -> None:
    """Print an error message on stderr without rich. If stderr cannot be written, the exit code has to do."""
    with suppress(OSError):
        sys.stderr.write(printable(message, keep="\n") + "\n")
        sys.stderr.flush()


def _stdout_console() -> "Console":
    from .printable_console import PrintableConsole

    return PrintableConsole(highlight=False, emoji=False)


@cache
def _stderr_console() -> "Console":
    """One console, so that a message is printed above a progress bar, and not at its end."""
    from .printable_console import PrintableConsole

    return PrintableConsole(stderr=True, highlight=False, emoji=False)
