"""The folder of a batch: `scenes/` with a finished folder per scene, `unfinished/`, `batch.json` and `summary.json`.

A scene is written to `unfinished/` and renamed to `scenes/` when it is complete, so `scenes/` only has complete ones.
"""

import json
import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from ...runtime.errors import OutputError, UsageError
from ...runtime.files import output_errors, remove_temporary, write_atomically
from ...runtime.strict_json import parse_strict_json
from ..folder_lock import lock_folder
from ..notify import Notify
from ..output_folder import check_writable, find_files, make_folders, remove_files
from ..resuming import check_same_settings
from ..run_folder import SUBMISSION_NAME, RunSettings, read_run_settings

BATCH_NAME = "batch.json"
SUMMARY_NAME = "summary.json"
SCENES = "scenes"
UNFINISHED = "unfinished"
_RANDOM = "[0-9a-f]" * 8  # the random part of a temporary file's name
_TEMPORARY_FILES = (f".batch.{_RANDOM}.json", f".summary.{_RANDOM}.json", f".results_nusc.{_RANDOM}.json")


class SceneFolders:
    """The paths of one scene in the folder of a batch.

    finished: its folder, once the scene is complete. unfinished: until then.
    tries: a file that counts how often a worker process has begun the scene.
    """

    def __init__(self, out: Path, folder: str) -> None:
        self.finished = out / SCENES / folder
        self.unfinished = out / UNFINISHED / folder
        self.tries = out / UNFINISHED / f".{folder}.tries"  # no folder of a scene has a dot in front

    def finish(self, summary: Mapping[str, Any]) -> None:
        """Write the scene's summary and rename its folder. Raises OutputError."""
        write_atomically(self.unfinished / SUMMARY_NAME, to_json(summary))
        with output_errors(self.finished):
            self.unfinished.rename(self.finished)
        remove_temporary(self.tries)

    def discard_unfinished(self) -> None:
        """Remove unfinished results, if there are any. Raises OutputError."""
        if self.unfinished.exists():
            with output_errors(self.unfinished):
                shutil.rmtree(self.unfinished)

    def count_try(self, call: str) -> int:
        """Count one more try of a call of `batch`. Returns the number of tries before this one. Raises OutputError.

        call: a text that no other call has. The tries of an earlier call do not count.
        """
        try:
            earlier_call, number = self.tries.read_text().split()
            tries = int(number) if earlier_call == call else 0
        except (OSError, ValueError):
            tries = 0
        write_atomically(self.tries, f"{call} {tries + 1}".encode())
        return tries


def check_batch_folder(out: Path, resume: bool) -> None:
    """Check that a batch may write to `out`. Changes nothing there. Raises OutputError."""
    check_writable(out)
    names = (BATCH_NAME, SCENES, UNFINISHED, SUMMARY_NAME, SUBMISSION_NAME)
    found = next((out / name for name in names if (out / name).exists()), None)
    if found is not None and not (out / BATCH_NAME).is_file():
        raise OutputError(
            f"{found}: expected the results of an earlier batch; there is no {BATCH_NAME} beside it. Choose another "
            "--out."
        )
    if found is not None and not resume:
        raise OutputError(f"{found}: an earlier batch wrote this. Choose another --out, or add --resume.")


@contextmanager
def open_batch_folder(out: Path, settings: RunSettings, *, resume: bool, notify: Notify) -> Iterator[None]:
    """Lock `out` for one batch, and prepare its folders. Removes the summary of an earlier call.

    settings: of the runs of all scenes, without their sources.
    Raises OutputError, also if another process is writing to `out`. Raises UsageError for a batch with other settings.
    """
    make_folders(out, ("",))
    with lock_folder(out, notify):
        if (out / BATCH_NAME).exists():
            check_batch_folder(out, resume)  # again: another batch may have begun before the lock
        check_resumable(out, settings)
        make_folders(out, (SCENES, UNFINISHED))
        try:
            write_atomically(out / BATCH_NAME, to_json(settings))
            remove_files([out / SUMMARY_NAME, out / SUBMISSION_NAME, *find_files(out, _TEMPORARY_FILES)])
            yield
        finally:  # under the lock: another process that is refused must not remove the folders of this one
            _remove_empty(out)


def _remove_empty(out: Path) -> None:
    """Remove folders without scenes, and `batch.json` if no scene was begun. Raises OutputError."""
    for folder in (UNFINISHED, SCENES):
        with suppress(OSError):  # it has scenes
            (out / folder).rmdir()
    if not any((out / name).exists() for name in (UNFINISHED, SCENES, SUMMARY_NAME)):
        remove_files([out / BATCH_NAME])


def check_resumable(out: Path, settings: RunSettings) -> None:
    """Check that an earlier batch in `out` has the same settings. Raises UsageError, and OutputError."""
    path = out / BATCH_NAME
    try:
        recorded = dict(parse_strict_json(path.read_bytes()))
    except FileNotFoundError:
        return
    except (OSError, ValueError, TypeError, RecursionError):
        raise OutputError(f"{path}: cannot be read. Choose another --out.") from None
    check_same_settings("batch", path, recorded, settings, "choose another --out")


def finished_folders(out: Path) -> set[str]:
    """The names of the finished scenes' folders."""
    folder = out / SCENES
    if not folder.is_dir():
        return set()
    return {path.name for path in folder.iterdir() if not path.name.startswith(".")}  # those are of file systems


def check_known_folders(out: Path, finished: Collection[str], known: Collection[str]) -> None:
    """Check that every finished folder is of a scene of this call. Raises UsageError."""
    if unknown := sorted(set(finished) - set(known)):
        raise UsageError(
            f"--resume: {out / SCENES / unknown[0]}: expected a scene of these sources; got another one. Name all "
            "sources of the first call, in the same order, or choose another --out."
        )


def check_finished_run(out: Path, folder: str, settings: RunSettings) -> None:
    """Check that a finished scene was run with these settings. Raises UsageError."""
    path = out / SCENES / folder
    recorded = read_run_settings(path) or {}
    check_same_settings("scene", path, recorded, settings, "choose another --out")


def to_json(value: Mapping[str, Any]) -> bytes:
    """A JSON file with an indent, in ASCII."""
    return (json.dumps(value, indent=2, allow_nan=False) + "\n").encode()
