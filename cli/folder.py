"""The folder of a command: what it writes there, and nothing else, is replaced or continued by another run of it."""

import json
from collections.abc import Sequence
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

Job = dict[str, str | int | bool]  # all that decides what a run's results are, by name


def start_folder(out: Path, overwrite: bool) -> None:
    """Make `out`, with none of an earlier run's results in it. Raises OutputError."""
    prepare_folder(out, overwrite, WRITTEN, FOLDERS, advice="add --overwrite, or --resume where that run broke off")
    _make(out, FOLDERS, without=_find(out, LEFT_BEHIND))


def resume_folder(out: Path, job: Job) -> None:
    """Make `out` ready to go on with `job`, or to start it. Raises UsageError where another job began there."""
    _check_folder(out)
    path = out / JOB_NAME
    if not path.exists():
        start_folder(out, overwrite=False)
        return
    try:
        began = dict(json.loads(path.read_bytes()))
    except (OSError, ValueError, TypeError):
        began = {}
    for name, asked in job.items():
        if began.get(name) != asked:
            raise UsageError(
                f"--resume: {path}: the run began with {name} {began.get(name)!r}; got {asked!r}. "
                "Ask for the same, or start anew with --overwrite."
            )
    _make(out, FOLDERS, without=_find(out, (*LEFT_BEHIND, SUBMISSION_NAME, VIDEO_NAME)))


def write_job(out: Path, job: Job) -> None:
    """Note what the run is about, for a later one to go on with. Raises OutputError."""
    write_atomically(out / JOB_NAME, json.dumps(job, indent=2).encode())


def prepare_folder(
    out: Path, overwrite: bool, written: Sequence[str], folders: Sequence[str], advice: str = "add --overwrite"
) -> None:
    """Make `out` and `folders` in it, without the files of an earlier command, which the patterns `written` find there.

    Raises OutputError, with `advice`, where there are some and `overwrite` was not asked for.
    """
    _check_folder(out)
    there = _find(out, written)
    if there and not overwrite:
        raise OutputError(f"{there[0]}: an earlier run wrote it. Choose another --out, or {advice}.")
    _make(out, folders, without=there)


def check_apart(out: Path, source: str) -> None:
    """Refuse to write where the images of a source lie. Raises UsageError."""
    path = Path(source)
    folder = path if path.is_dir() else path.parent
    if path.exists() and out.exists() and out.samefile(folder):
        raise UsageError(f"--out: expected another folder than the source's; got {out}. Choose one beside or in it.")


def _check_folder(out: Path) -> None:
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out}: expected a folder; got a file. Choose another --out.")


def _find(out: Path, patterns: Sequence[str]) -> list[Path]:
    return [path for pattern in patterns for path in out.glob(pattern)]


def _make(out: Path, folders: Sequence[str], without: Sequence[Path]) -> None:
    """Make the folder and those in it, and remove files from them; see that it can be written to."""
    try:
        for folder in folders:
            (out / folder).mkdir(parents=True, exist_ok=True)
        for path in without:
            path.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror}). Choose another --out.") from error
