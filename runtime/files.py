"""Files that are either whole or not there: written beside their place, then moved into it."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import OutputError


def write_atomically(path: Path | str, data: bytes) -> None:
    """Write a file so that `path` holds either all of `data` or what it held before.

    Raises OutputError naming `path` when it cannot be written; nothing is left behind then.
    """
    with atomic_path(Path(path)) as temporary:
        temporary.write_bytes(data)


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """A temporary name to write to; the file takes the name `path` when the block has ended well.

    Raises OutputError naming `path` when it cannot be written; nothing is left behind then.
    """
    temporary = temporary_path(path)
    try:
        yield temporary
        move_into_place(temporary, path)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error
    finally:
        remove_temporary(temporary)


@contextmanager
def path_for_native_code(path: Path) -> Iterator[str]:
    """A name of an existing file or folder that a C++ library takes in any locale.

    Python holds the bytes of a name that the locale cannot read as lone surrogates, which do not pass as text; such
    a file is opened, and named by its descriptor (Linux).
    """
    name = str(path)
    try:
        name.encode()
    except UnicodeEncodeError:
        descriptor = os.open(path, os.O_RDONLY)
        try:
            yield f"/proc/self/fd/{descriptor}"
        finally:
            os.close(descriptor)
    else:
        yield name


def temporary_path(path: Path) -> Path:
    """A new hidden name in the folder of `path`, with the same suffix."""
    return path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")


def move_into_place(temporary: Path, path: Path) -> None:
    """Let a finished file reach the disk, then take the name `path`, replacing what was there."""
    with temporary.open("rb+") as file:
        os.fsync(file.fileno())
    temporary.replace(path)


def remove_temporary(temporary: Path) -> None:
    """Remove a temporary file if it is still there."""
    with suppress(OSError):
        temporary.unlink()
