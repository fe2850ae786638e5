"""Optional packages: imported where they are needed, with an error that names the extra to install."""

from collections.abc import Iterator
from contextlib import contextmanager

from .errors import MissingExtraError


@contextmanager
def needs_extra(extra: str) -> Iterator[None]:
    """Wrap imports of optional packages. Raises MissingExtraError with the command that installs the extra."""
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(
            f"expected the package {error.name} from the extra '{extra}'; it is not installed. "
            f"Install it: pip install 'duospacenet[{extra}]'"
        ) from error
