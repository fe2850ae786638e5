"""Progress: a callback that long work passes its items through, so that a caller can show how far it is."""

from collections.abc import Iterable, Iterator
from typing import Protocol, TypeVar

Item = TypeVar("Item")


class Progress(Protocol):
    """Yields the items unchanged. `description` names the work, for example "parity"."""

    def __call__(self, items: Iterable[Item], description: str, total: int | None = None) -> Iterator[Item]:
        """total: the number of items, where `items` does not know its length."""


def no_progress(items: Iterable[Item], description: str, total: int | None = None) -> Iterator[Item]:
    """Show nothing."""
    yield from items
