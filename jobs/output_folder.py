"""The folder of a command: what it writes there, and nothing else, is replaced or continued by another run of it."""

import fcntl
import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from ..runtime.errors import OutputError, UsageError
from ..runtime.files import write_atomically

JOB_NAME = "run.json"
RESULTS_NAME = "results.jsonl"
SUBMISSION_NAME = "results_nusc.json"
VIDEO_NAME = "video.mp4"
RANDOM = "[0-9a-f]" * 8  # of a file that was being written when a run was killed
SIX_DIGITS = "[0-9]" * 6

FOLDERS = ("pictures", "maps")
WRITTEN = (
    JOB_NAME,
    RESULTS_NAME,
    SUBMISSION_NAME,
    VIDEO_NAME,
    f"pictures/{SIX_DIGITS}.png",
    f"maps/{SIX_DIGITS}_*.png",
)
LEFT_BEHIND = (
    f".run.{RANDOM}.json",
    f".results_nusc.{RANDOM}.json",
    f".video.{RANDOM}.mp4",
    f"pictures/.{SIX_DIGITS}.{RANDOM}.png",
    f"maps/.{SIX_DIGITS}_*.{RANDOM}.png",
)

Job = dict[str, str | int | float | bool]  # all that decides what a run's files are, by name


def check_run_folder(out: Path, overwrite: bool, resume: bool) -> None:
    """See that a run may write to `out`, and change nothing there. Raises OutputError.

    Files that look like a run's are taken for one's only where its `run.json` is: they may be somebody's own pictures.
    """
    check_writable(out)
    there = _find(out, WRITTEN)
    if there and not (out / JOB_NAME).exists():
        raise OutputError(f"{there[0]}: no run of this toolkit is known to have written it. Choose another --out.")
    if there and not overwrite and not resume:
        raise OutputError(
            f"{there[0]}: an earlier run wrote it. Choose another --out, or add --overwrite, "
            "or --resume where that run broke off."
        )


def check_job(out: Path, job: Job) -> None:
    """Raises UsageError where another job than `job` began in `out`, and cannot be gone on with."""
    began = read_job(out)
    for name, asked in job.items():
        if began is not None and began.get(name) != asked:
            raise UsageError(
                f"--resume: {out / JOB_NAME}: the run began with {name} {began.get(name)!r}; got {asked!r}. "
                "Ask for the same, or start anew with --overwrite."
            )


def read_job(out: Path) -> dict | None:
    """What a run in `out` is about; None where there is none, and nothing of it where that cannot be read."""
    try:
        return dict(json.loads((out / JOB_NAME).read_bytes()))
    except FileNotFoundError:
        return None
    except (OSError, ValueError, TypeError, RecursionError):
        return {}


@contextmanager
def run_folder(out: Path, job: Job, resume: bool) -> Iterator[None]:
    """Hold `out` for one run, without what another left in it; where it is resumed, without what it left half-written.

    Raises OutputError, also where another process is at work there.
    """
    make_folders(out, FOLDERS)
    with held(out):
        remove(_find(out, LEFT_BEHIND if resume else (*WRITTEN, *LEFT_BEHIND)))
        write_atomically(out / JOB_NAME, json.dumps(job, indent=2).encode())
        yield


@contextmanager
def held(out: Path) -> Iterator[None]:
    """Hold the folder `out`. Raises OutputError where another process does, or it cannot be held."""
    with ExitStack() as stack:
        try:
            descriptor = os.open(out, os.O_RDONLY)
            stack.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(f"{out}: another run is writing there. Wait for it, or choose another --out.") from None
        except OSError as error:
            raise OutputError(f"{out}: cannot be locked ({error.strerror}). Choose another --out.") from error
        yield


def check_writable(out: Path) -> None:
    """Raises OutputError where no folder `out` is, or can be made and written to."""
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out}: expected a folder; got a file. Choose another --out.")
    place = next((place for place in (out, *out.parents) if place.exists()), Path())
    try:
        with tempfile.TemporaryFile(dir=place):
            pass
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror}). Choose another --out.") from error


def make_folders(out: Path, folders: Sequence[str]) -> None:
    """Make `out` and folders in it. Raises OutputError."""
    try:
        for folder in folders:
            (out / folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror}). Choose another --out.") from error


def remove(paths: Sequence[Path]) -> None:
    """Remove files. Raises OutputError."""
    try:
        for path in paths:
            with suppress(FileNotFoundError):
                path.unlink()
    except OSError as error:
        raise OutputError(f"{error.filename}: cannot be removed ({error.strerror}).") from error


def prepare_folder(out: Path, overwrite: bool, written: Sequence[str], folders: Sequence[str]) -> None:
    """Make `out` and `folders` in it, without the files of an earlier command, which the patterns `written` find there.

    Raises OutputError where there are some and `overwrite` was not asked for.
    """
    check_writable(out)
    there = _find(out, written)
    if there and not overwrite:
        raise OutputError(f"{there[0]}: an earlier run wrote it. Choose another --out, or add --overwrite.")
    make_folders(out, folders)
    remove(there)


def check_apart(out: Path, source: str) -> None:
    """Refuse to write where the images of a source lie. Raises UsageError."""
    path = Path(source)
    folder = path if path.is_dir() else path.parent
    if path.exists() and out.exists() and out.samefile(folder):
        raise UsageError(f"--out: expected another folder than the source's; got {out}. Choose one beside or in it.")


def _find(out: Path, patterns: Sequence[str]) -> list[Path]:
    return [path for pattern in patterns for path in out.glob(pattern)]
