"""The folder of a run: `run.json`, results, pictures and maps. A run only replaces files that a run has written."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from ..runtime.errors import OutputError
from ..runtime.files import write_atomically
from .folder_lock import lock_folder
from .notify import Notify, ignore
from .output_folder import check_writable, find_files, make_folders, remove_files
from .resuming import check_same_settings

RUN_NAME = "run.json"
RESULTS_NAME = "results.jsonl"
SUBMISSION_NAME = "results_nusc.json"
VIDEO_NAME = "video.mp4"
SUBFOLDERS = ("pictures", "maps")

_RANDOM = "[0-9a-f]" * 8  # the random part of a temporary file's name
_FRAME = "[0-9]" * 6
_OUTPUTS = (
    RUN_NAME,
    RESULTS_NAME,
    SUBMISSION_NAME,
    VIDEO_NAME,
    f"pictures/{_FRAME}.png",
    f"maps/{_FRAME}_*.png",
)
_TEMPORARY_FILES = (  # a killed run leaves them behind
    f".run.{_RANDOM}.json",
    f".results_nusc.{_RANDOM}.json",
    f".video.{_RANDOM}.mp4",
    f"pictures/.{_FRAME}.{_RANDOM}.png",
    f"maps/.{_FRAME}_*.{_RANDOM}.png",
)

RunSettings = dict[str, str | int | float | bool]  # everything that decides the bytes of a run's files, by name


@contextmanager
def open_run_folder(out: Path, settings: RunSettings, resume: bool, notify: Notify = ignore) -> Iterator[None]:
    """Lock `out` for one run and record its settings in `run.json`.

    A new run first removes the files of an earlier run. A resumed run only removes temporary files of the
    interrupted run.
    notify: gets a warning if the file system has no locks.
    Raises OutputError, also if another process is writing to `out`.
    """
    make_folders(out, SUBFOLDERS)
    with lock_folder(out, notify):
        remove_files(find_files(out, _TEMPORARY_FILES if resume else (*_OUTPUTS, *_TEMPORARY_FILES)))
        write_atomically(out / RUN_NAME, json.dumps(settings, indent=2).encode())
        yield


def check_run_folder(out: Path, overwrite: bool, resume: bool) -> None:
    """Check that a run may write to `out`. Changes nothing there. Raises OutputError.

    Files with the names of a run's outputs belong to a run only if `run.json` is beside them. Otherwise they may be
    the user's own pictures.
    """
    check_writable(out)
    outputs = find_files(out, _OUTPUTS)
    if outputs and not (out / RUN_NAME).exists():
        raise OutputError(f"{outputs[0]}: no {RUN_NAME} shows that a run wrote this file. Choose another --out.")
    if outputs and not overwrite and not resume:
        raise OutputError(
            f"{outputs[0]}: an earlier run wrote this file. Choose another --out, or add --overwrite, "
            "or --resume to continue an interrupted run."
        )


def check_resumable(out: Path, settings: RunSettings) -> None:
    """Check that the run in `out`, if there is one, began with the same settings. Raises UsageError."""
    recorded = read_run_settings(out)
    if recorded is not None:
        check_same_settings("run", out / RUN_NAME, recorded, settings, "start again with --overwrite")


def read_run_settings(out: Path) -> RunSettings | None:
    """The settings of the run in `out`: None without `run.json`, empty if `run.json` cannot be read."""
    try:
        return dict(json.loads((out / RUN_NAME).read_bytes()))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, RecursionError):
        return {}
