"""The display of progress on stderr: a bar in a terminal, and a line of text now and then in a pipe."""

import time
from collections.abc import Callable, Iterable, Iterator, Sized
from typing import TYPE_CHECKING, NamedTuple, TypeVar

from ..runtime.progress import describe_duration

if TYPE_CHECKING:
    from rich.console import Console

Item = TypeVar("Item")

LINE_INTERVAL_S = 30.0  # between two lines in a pipe


class _Work(NamedTuple):
    """Work on a number of items. done: of them, before it began. total: with those, if known."""

    description: str
    total: int | None
    done: int


def display_progress(
    console: "Console",
    items: Iterable[Item],
    description: str,
    total: int | None,
    done: int,
    label: Callable[[Item], str] | None,
    print_line: Callable[[str], None],
) -> Iterator[Item]:
    """Yield the items, and show how many are done, how fast, and how much time is left. See `runtime.progress`."""
    if total is None and isinstance(items, Sized):
        total = done + len(items)
    work = _Work(description, total, done)
    if console.is_terminal:
        yield from _with_bar(console, items, work, label)
    else:
        yield from _with_lines(items, work, label, print_line)


def _with_bar(
    console: "Console", items: Iterable[Item], work: _Work, label: Callable[[Item], str] | None
) -> Iterator[Item]:
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(bar_width=20),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}", markup=False),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[label]}", markup=False),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task(work.description, total=work.total, completed=work.done, rate="", label="")
        for item in items:
            speed = progress.tasks[0].speed
            rate = _rate(speed) if speed else ""
            progress.update(task, rate=rate, label=label(item) if label else "")
            yield item
            progress.advance(task)


def _with_lines(
    items: Iterable[Item],
    work: _Work,
    label: Callable[[Item], str] | None,
    print_line: Callable[[str], None],
) -> Iterator[Item]:
    print_line(f"{work.description} ...")
    start_s = printed_s = time.monotonic()
    for passed, item in enumerate(items):
        now_s = time.monotonic()
        if now_s - printed_s >= LINE_INTERVAL_S:
            printed_s = now_s
            parts = [_describe(work, passed, now_s - start_s), *([label(item)] if label else [])]
            print_line(f"{work.description}: {', '.join(parts)}")
        yield item


def _describe(work: _Work, passed: int, elapsed_s: float) -> str:
    """For example "120 of 400, 2.0/s, 2 min left"."""
    rate, number = passed / elapsed_s, work.done + passed
    if work.total is None:
        return f"{number}, {_rate(rate)}"
    left = f", {describe_duration((work.total - number) / rate)} left" if rate else ""
    return f"{number} of {work.total}, {_rate(rate)}{left}"


def _rate(per_second: float) -> str:
    return f"{per_second:.1f}/s" if per_second >= 1 else f"{per_second:.2g}/s"
