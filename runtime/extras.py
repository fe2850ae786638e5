"""Optional packages: imported where they are used, with a message that names the extra to install."""

from collections.abc import Iterator
from contextlib import contextmanager

from .errors import MissingExtraError


@contextmanager
def needs_extra(extra: str) -> Iterator[None]:
    """Wrap imports of packages that the optional extra `extra` installs.

    Raises MissingExtraError, with the command to install the extra, if an import fails.
    """
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(
            f"expected the package {error.name}, of the extra '{extra}'; it is not installed. "
            f"Install it: pip install 'duospacenet[{extra}]'"
        ) from error
