"""Progress of long work: a function that yields the items of a loop and may show a progress bar."""

from collections.abc import Callable, Iterable, Iterator
from typing import Protocol, TypeVar

Item = TypeVar("Item")


class Progress(Protocol):
    """A function that yields the items unchanged and may show how many have passed."""

    def __call__(
        self,
        items: Iterable[Item],
        description: str,
        total: int | None = None,
        *,
        done: int = 0,
        label: Callable[[Item], str] | None = None,
    ) -> Iterator[Item]:
        """Yield the items.

        description: the name of the work, for example "parity".
        total: number of items, if `len` is unknown.
        done: number of items before these that are done already, for example by an interrupted run.
        label: a text about an item, to show while it is processed, for example its scene.
        """


def no_progress(
    items: Iterable[Item],
    description: str,
    total: int | None = None,
    *,
    done: int = 0,
    label: Callable[[Item], str] | None = None,
) -> Iterator[Item]:
    """Yield the items unchanged, and show nothing."""
    yield from items


def describe_duration(seconds: float) -> str:
    """Return a duration in the unit that fits, for example "59 s" or "2 h 30 min"."""
    if seconds < 60:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"
