"""Atomic writes: a file or folder is written under a temporary name and then renamed, so it is complete or absent."""

import os
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import OutputError


def write_atomically(path: Path | str, data: bytes) -> None:
    """Write a file. Afterwards `path` contains either all of `data` or its previous content.

    Raises OutputError, naming `path`, if it cannot be written. No temporary file remains.
    """
    with atomic_path(Path(path)) as temporary:
        temporary.write_bytes(data)


@contextmanager
def atomic_path(path: Path) -> Iterator[Path]:
    """Give a temporary path to write to, and rename it to `path` when the block ends without an exception.

    Raises OutputError, naming `path`, if it cannot be written. No temporary file remains.
    """
    temporary = temporary_path(path)
    try:
        with output_errors(path):
            yield temporary
            move_into_place(temporary, path)
    finally:
        remove_temporary(temporary)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """Give a staging directory to write to, and rename it to `path` when the block ends without an exception.

    Raises OutputError, naming `path`, if it cannot be written. No staging directory remains.
    """
    staging_dir = temporary_path(path)
    try:
        staging_dir.mkdir(parents=True)
        yield staging_dir
        staging_dir.rename(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror}).") from error
    finally:
        shutil.rmtree(staging_dir, ignore_errors=True)


@contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Convert an OSError in the block to an OutputError that names `path`."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error


@contextmanager
def path_for_native_code(path: Path) -> Iterator[str]:
    """Give a name of an existing file or folder that C++ libraries can open in any locale.

    Python keeps bytes of a file name that are not valid in the locale as lone surrogates. C++ bindings reject such a
    string, because it cannot be encoded as UTF-8. The file is then opened here and named by its descriptor, which
    needs Linux.
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
    """Return a new hidden name in the folder of `path`, with the same suffix."""
    return path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")


def move_into_place(temporary: Path, path: Path) -> None:
    """Flush a finished file to disk, then rename it to `path`, replacing an existing file."""
    # Without fsync a power failure after the rename could leave an empty file under the final name.
    with temporary.open("rb+") as file:
        os.fsync(file.fileno())
    temporary.replace(path)


def remove_temporary(temporary: Path) -> None:
    """Remove a temporary file if it still exists."""
    with suppress(OSError):
        temporary.unlink()
