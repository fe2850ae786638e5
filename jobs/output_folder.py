"""An output folder: checks before anything is written, and the removal of files that an earlier job wrote."""

import tempfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from ..runtime.errors import OutputError, UsageError
from .sources import source_path


def check_writable(out: Path) -> None:
    """Check that `out` is a folder that can be written to, or can be created. Leaves nothing behind.

    Raises OutputError otherwise.
    """
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out}: expected a folder; got a file. Choose another --out.")
    nearest = next((folder for folder in (out, *out.parents) if folder.exists()), Path())
    try:
        with tempfile.TemporaryFile(dir=nearest):
            pass
    except OSError as error:
        raise _not_writable(out, error) from error


def check_not_source(out: Path, source: str | Path) -> None:
    """Check that `out` is not the folder that holds the source's images. Raises UsageError."""
    path = source_path(source)
    folder = path if path.is_dir() else path.parent
    if path.exists() and out.exists() and out.samefile(folder):
        raise UsageError(
            f"--out: expected a folder other than the source's; got {out}. Choose one beside the source or inside it."
        )


def make_folders(out: Path, subfolders: Sequence[str]) -> None:
    """Create folders inside `out`, and `out` itself. Raises OutputError."""
    for subfolder in subfolders:
        try:
            (out / subfolder).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise _not_writable(out / subfolder, error) from error


def find_files(out: Path, patterns: Sequence[str]) -> list[Path]:
    """The files in `out` that match any of these glob patterns."""
    return [path for pattern in patterns for path in out.glob(pattern)]


def remove_files(paths: Sequence[Path]) -> None:
    """Remove files; files that no longer exist are ignored. Raises OutputError."""
    try:
        for path in paths:
            with suppress(FileNotFoundError):
                path.unlink()
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot be removed ({error.strerror}).") from error


def _not_writable(out: Path, error: OSError) -> OutputError:
    return OutputError(f"{out}: cannot be written ({error.strerror}). Choose another --out.")
