"""Safe reading and writing of files.

Only regular files of a limited size are read. A file or folder is written under a temporary name and then renamed, so
it is complete or absent.
"""

import os
import secrets
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import DuoSpaceNetError, OutputError

START_BYTES = 65536

_KINDS = (  # other kinds than a regular file
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe (FIFO)"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


def check_regular_file(path: Path, max_bytes: int, error: type[DuoSpaceNetError]) -> int:
    """Check the kind and the size of a file without opening it, and return its size.

    Opening a FIFO can wait forever, and opening a device can have side effects. A sparse file can claim any size.

    error: the class of the exception.
    Raises `error`, naming the file, if there is no such regular file or it has more than `max_bytes` bytes.
    """
    with _input_errors(path, error):
        status = path.stat()
    return _check_status(path, status, max_bytes, error)


def change_stamp(status: os.stat_result) -> tuple[int, int]:
    """Return what changes when a file is written: its size [bytes] and the time of its last change [ns]."""
    return status.st_size, status.st_mtime_ns


def read_regular_file(path: Path, max_bytes: int, error: type[DuoSpaceNetError], start_only: bool = False) -> bytes:
    """Read a file after `check_regular_file`. Raises `error`, naming the file.

    start_only: read only the first `START_BYTES` bytes, of a file of any size up to `max_bytes`.
    """
    check_regular_file(path, max_bytes, error)
    # The file may be replaced after the check. O_NONBLOCK keeps open() from waiting for the writer of a FIFO.
    with _input_errors(path, error), open(path, "rb", opener=_open_without_waiting) as file:
        size = _check_status(path, os.fstat(file.fileno()), max_bytes, error)
        content = file.read(min(size, START_BYTES) if start_only else size + 1)
    if not start_only and len(content) != size:
        raise error(f"{path}: expected a file of {size} bytes; its size changed while it was read. Try again.")
    return content


def _check_status(path: Path, status: os.stat_result, max_bytes: int, error: type[DuoSpaceNetError]) -> int:
    if not stat.S_ISREG(status.st_mode):
        kind = next((name for is_kind, name in _KINDS if is_kind(status.st_mode)), "a special file")
        raise error(f"{path}: expected a regular file; got {kind}. Copy the data into a file.")
    if status.st_size > max_bytes:
        raise error(f"{path}: expected a file of at most {max_bytes} bytes; got {status.st_size}.")
    return status.st_size


def _open_without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)


@contextmanager
def _input_errors(path: Path, error: type[DuoSpaceNetError]) -> Iterator[None]:
    """Convert an OSError in the block, or the ValueError of a file name with a NUL byte, to an `error`."""
    try:
        yield
    except FileNotFoundError:
        raise error(f"{path}: expected a file; got no such file.") from None
    except OSError as cause:
        raise error(f"{path}: cannot be read ({cause.strerror}).") from None
    except ValueError as cause:
        raise error(f"{path}: cannot be read ({cause}).") from None


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
def atomic_folder(path: Path, replace: bool = False) -> Iterator[Path]:
    """Give a staging directory to write to, and rename it to `path` when the block ends without an exception.

    replace: an existing folder `path` is removed then. A process that is killed between two renames leaves the earlier
        folder under a hidden name beside `path`.
    Raises OutputError, naming `path`, if it cannot be written. No staging directory remains.
    """
    staging_dir, earlier = temporary_path(path), temporary_path(path)
    try:
        staging_dir.mkdir(parents=True)
        yield staging_dir
        if replace and path.exists():
            path.rename(earlier)
        staging_dir.rename(path)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written ({error.strerror}).") from error
    finally:
        shutil.rmtree(staging_dir, ignore_errors=True)
        if earlier.exists() and not path.exists():
            earlier.rename(path)
        shutil.rmtree(earlier, ignore_errors=True)


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
