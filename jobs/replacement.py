"""The replacement of an earlier run's files by those of a new run, which are written beside them.

A folder `out` in which a run replaces another is in one of three states. Each begins with one rename, so a process that
is killed leaves one of them, and `complete_replacement` continues from there:

1. `.duospacenet-new` holds an unfinished run. The earlier files are unchanged.
2. `.duospacenet-finished` holds a finished run. Earlier files without a new file of the same name are removed.
3. `.duospacenet-moving` holds a finished run. Its files are moved to `out`, where they replace those of the same name.
"""

import errno
import shutil
from collections.abc import Sequence
from pathlib import Path

from ..runtime.errors import OutputError
from ..runtime.files import move_into_place, remove_temporary, temporary_path
from .output_folder import find_files, remove_files

NEW = ".duospacenet-new"
FINISHED = ".duospacenet-finished"
MOVING = ".duospacenet-moving"


def discard_new(out: Path) -> None:
    """Remove an unfinished run that was to replace the files in `out`. Raises OutputError."""
    _remove_tree(out / NEW)


def replace_earlier(out: Path, patterns: Sequence[str]) -> None:
    """Replace the files in `out` that match `patterns` by the finished run in `out / NEW`. Raises OutputError."""
    _rename(out / NEW, out / FINISHED)
    complete_replacement(out, patterns)


def is_replacement_pending(out: Path) -> bool:
    """Whether a process was killed while it replaced files in `out` by those of a finished run."""
    return (out / FINISHED).exists() or (out / MOVING).exists()


def complete_replacement(out: Path, patterns: Sequence[str]) -> None:
    """Complete a replacement that was interrupted, if there is one. Raises OutputError."""
    if (out / FINISHED).exists():
        kept = {path.relative_to(out / FINISHED) for path in find_files(out / FINISHED, patterns)}
        remove_files([path for path in find_files(out, patterns) if path.relative_to(out) not in kept])
        _rename(out / FINISHED, out / MOVING)
    if (out / MOVING).exists():
        for path in find_files(out / MOVING, patterns):
            _move(path, out / path.relative_to(out / MOVING))
        _remove_tree(out / MOVING)


def _move(path: Path, target: Path) -> None:
    try:
        target.parent.mkdir(exist_ok=True)
        path.replace(target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise OutputError(f"{target}: cannot be replaced ({error.strerror}).") from error
        _move_to_other_file_system(path, target)


def _move_to_other_file_system(path: Path, target: Path) -> None:
    """Move a file into a subfolder of `out` that is a link to another file system."""
    temporary = temporary_path(target)
    try:
        shutil.copyfile(path, temporary)
        move_into_place(temporary, target)
        path.unlink()
    except OSError as error:
        raise OutputError(f"{target}: cannot be replaced ({error.strerror}).") from error
    finally:
        remove_temporary(temporary)


def _rename(folder: Path, name: Path) -> None:
    try:
        folder.rename(name)
    except OSError as error:
        raise OutputError(f"{folder}: cannot be renamed ({error.strerror}).") from error


def _remove_tree(folder: Path) -> None:
    try:
        shutil.rmtree(folder)
    except FileNotFoundError:
        pass
    except OSError as error:
        raise OutputError(f"{folder}: cannot be removed ({error.strerror}).") from error
