"""Optional packages: imported where they are needed, and asked for by the extra that installs them."""

from collections.abc import Iterator
from contextlib import contextmanager

from .errors import MissingExtraError


@contextmanager
def needs_extra(extra: str) -> Iterator[None]:
    """Around imports of optional packages. Raises MissingExtraError, saying what to install."""
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(
            f"expected the package {error.name}, of the extra '{extra}'; it is not installed. "
            f"Install it: pip install 'duospacenet[{extra}]'"
        ) from error
