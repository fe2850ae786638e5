"""Notify: a callback for messages to the user, passed in by the caller."""

from collections.abc import Callable

Notify = Callable[[str], None]


def ignore(message: str) -> None:
    """Show no messages."""
