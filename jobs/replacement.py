"""The replacement of an earlier job's files by those of a new job, which are written beside them.

A folder `out` in which a job replaces another is in one of three states. Each begins with one rename, so a process that
is killed leaves one of them, and `Replacement.complete` continues from there:

1. `.duospacenet-new` holds unfinished files. The earlier files are unchanged.
2. `.duospacenet-finished` holds finished files. Earlier files without a new file of the same name are removed.
3. `.duospacenet-moving` holds finished files. They are moved to `out`, where they replace those of the same name.
"""

import errno
import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..runtime.errors import OutputError
from ..runtime.files import move_into_place, remove_temporary, temporary_path
from .output_folder import find_files, remove_files


@dataclass(frozen=True)
class Replacement:
    """The replacement of the files in `out` that match the glob patterns.

    prefix: of the names of the three folders. Each kind of job has its own, so that no job moves the files of another.
    """

    out: Path
    patterns: Sequence[str]
    prefix: str = ".duospacenet"

    @property
    def new(self) -> Path:
        """The folder that the new job writes to."""
        return self.out / f"{self.prefix}-new"

    @property
    def finished(self) -> Path:
        """The folder of a finished job."""
        return self.out / f"{self.prefix}-finished"

    @property
    def moving(self) -> Path:
        """The folder of a finished job, after the earlier files without a replacement were removed."""
        return self.out / f"{self.prefix}-moving"

    @property
    def is_pending(self) -> bool:
        """Whether a process was killed while it replaced the files by those of a finished job."""
        return self.finished.exists() or self.moving.exists()

    def discard_new(self) -> None:
        """Remove the files of an unfinished job. Raises OutputError."""
        _remove_tree(self.new)

    def replace_earlier(self) -> None:
        """Replace the earlier files by the finished ones in `new`. Raises OutputError."""
        _rename(self.new, self.finished)
        self.complete()

    def complete(self) -> None:
        """Complete a replacement that was interrupted, if there is one. Raises OutputError."""
        if self.finished.exists():
            kept = {path.relative_to(self.finished) for path in find_files(self.finished, self.patterns)}
            earlier = find_files(self.out, self.patterns)
            remove_files([path for path in earlier if path.relative_to(self.out) not in kept])
            _rename(self.finished, self.moving)
        if self.moving.exists():
            for path in find_files(self.moving, self.patterns):
                _move(path, self.out / path.relative_to(self.moving))
            _remove_tree(self.moving)


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
