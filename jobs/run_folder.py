"""The folder of a run: `run.json`, results, pictures and maps. A run only replaces files that a run has written.

The files of an earlier run are only replaced when the new run is complete.
"""

import json
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from ..runtime.errors import OutputError
from ..runtime.files import write_atomically
from ..runtime.strict_json import parse_strict_json
from .folder_lock import lock_folder
from .notify import Notify, ignore
from .output_folder import check_writable, find_files, make_folders, remove_files
from .replacement import Replacement
from .resuming import check_same_settings

RUN_NAME = "run.json"
RESULTS_NAME = "results.jsonl"
SUBMISSION_NAME = "results_nusc.json"
VIDEO_NAME = "video.mp4"
SUBFOLDERS = ("pictures", "heatmaps", "maps")

_RANDOM = "[0-9a-f]" * 8  # the random part of a temporary file's name
_FRAME = "[0-9]" * 6
_OUTPUTS = (
    RUN_NAME,
    RESULTS_NAME,
    SUBMISSION_NAME,
    VIDEO_NAME,
    f"pictures/{_FRAME}.png",
    f"heatmaps/{_FRAME}.png",
    f"maps/{_FRAME}_*.png",
)
_TEMPORARY_FILES = (  # a killed run leaves them behind
    f".run.{_RANDOM}.json",
    f".results_nusc.{_RANDOM}.json",
    f".video.{_RANDOM}.mp4",
    f"pictures/.{_FRAME}.{_RANDOM}.png",
    f"heatmaps/.{_FRAME}.{_RANDOM}.png",
    f"maps/.{_FRAME}_*.{_RANDOM}.png",
)

RunSettings = dict[str, str | int | float | bool]  # everything that decides the bytes of a run's files, by name


@contextmanager
def open_run_folder(
    out: Path, settings: RunSettings, *, overwrite: bool = False, resume: bool = False, notify: Notify = ignore
) -> Iterator[Path]:
    """Lock `out` for one run, and give the folder that the run writes to, with its settings in `run.json`.

    This folder is `out` itself. If `out` has files of an earlier run, it is a folder inside `out`, and its files
    replace the earlier ones when the block ends without an exception. After an exception, the earlier files are
    unchanged, and the unfinished run can be resumed if it has any results.
    Raises OutputError, also if another process is writing to `out`. Raises UsageError as `find_resumable`.
    """
    make_folders(out, SUBFOLDERS)
    for subfolder in SUBFOLDERS:
        check_writable(out / subfolder)
    with lock_folder(out, notify):
        check_run_folder(out, overwrite, resume)  # again: another run may have written here before the lock
        replacement = _replacement(out)
        replacement.complete()
        folder = find_resumable(out, settings) if resume else _new_folder(replacement)
        make_folders(folder, SUBFOLDERS)
        remove_files(find_files(folder, _TEMPORARY_FILES))
        write_atomically(folder / RUN_NAME, json.dumps(settings, indent=2).encode())
        try:
            yield folder
        except BaseException:
            if folder != out:
                _end_unfinished(replacement, notify)
            raise
        else:
            if folder != out:
                replacement.replace_earlier()
        finally:
            _remove_empty_subfolders(out)


def check_run_folder(out: Path, overwrite: bool, resume: bool) -> None:
    """Check that a run may write to `out`. Changes nothing there. Raises OutputError.

    Files with the names of a run's outputs belong to a run only if `run.json` is beside them. Otherwise they may be
    the user's own pictures.
    """
    check_writable(out)
    replacement = _replacement(out)
    outputs = [*find_files(out, _OUTPUTS), *find_files(replacement.new, [RUN_NAME])]
    folders = out, replacement.new, replacement.finished, replacement.moving
    if outputs and not any((folder / RUN_NAME).exists() for folder in folders):
        raise OutputError(f"{outputs[0]}: no {RUN_NAME} shows that a run wrote this file. Choose another --out.")
    if outputs and not overwrite and not resume:
        raise OutputError(
            f"{outputs[0]}: an earlier run wrote this file. Choose another --out, or add --overwrite, "
            "or --resume to continue an interrupted run."
        )


def recover_run_folder(out: Path, notify: Notify = ignore) -> None:
    """If a run was killed while its files replaced those of an earlier run, complete this. Raises OutputError."""
    if _replacement(out).is_pending:
        with lock_folder(out, notify):
            _replacement(out).complete()


def find_resumable(out: Path, settings: RunSettings) -> Path:
    """Return the folder of the run that can be resumed with these settings: inside `out`, or `out` itself.

    The unfinished run of an interrupted `--overwrite` comes first, and then the earlier run in `out`.
    Raises UsageError, with the first setting that differs, if there are runs, and all have other settings.
    """
    folders = [folder for folder in (_replacement(out).new, out) if read_run_settings(folder) is not None]
    for folder in folders:
        if (read_run_settings(folder) or {}).items() >= settings.items():
            return folder
    if folders:
        recorded = read_run_settings(folders[0]) or {}
        check_same_settings("run", folders[0] / RUN_NAME, recorded, settings, "start again with --overwrite")
    return out


def read_run_settings(out: Path) -> RunSettings | None:
    """The settings of the run in `out`: None without `run.json`, empty if `run.json` cannot be read."""
    try:
        return dict(parse_strict_json((out / RUN_NAME).read_bytes()))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, RecursionError):
        return {}


def _remove_empty_subfolders(out: Path) -> None:
    for subfolder in SUBFOLDERS:
        with suppress(OSError):  # it holds files, or it is gone
            (out / subfolder).rmdir()


def _replacement(out: Path) -> Replacement:
    return Replacement(out, (*_OUTPUTS, *_TEMPORARY_FILES))


def _new_folder(replacement: Replacement) -> Path:
    """The folder that a new run writes to."""
    replacement.discard_new()
    return replacement.new if find_files(replacement.out, _OUTPUTS) else replacement.out


def _end_unfinished(replacement: Replacement, notify: Notify) -> None:
    """Keep an unfinished run that was to replace the files in `out`, if it has any results."""
    results = replacement.new / RESULTS_NAME
    if results.exists() and results.stat().st_size > 0:
        notify(f"The earlier results in {replacement.out} are unchanged. The new ones so far are in {replacement.new}.")
    else:
        replacement.discard_new()
