"""The folder of a run: what a run writes there, and nothing else, is replaced by another run."""

from collections.abc import Sequence
from pathlib import Path

from ..runtime.errors import OutputError

FOLDERS = ("pictures", "maps")
WRITTEN = (
    "results.jsonl",
    "results_nusc.json",
    "video.mp4",
    "pictures/[0-9][0-9][0-9][0-9][0-9][0-9].png",
    "maps/[0-9][0-9][0-9][0-9][0-9][0-9]_*.png",
)


def prepare_folder(
    out: Path, overwrite: bool, written: Sequence[str] = WRITTEN, folders: Sequence[str] = FOLDERS
) -> None:
    """Make `out` and `folders` in it, with none of an earlier run's results there. Raises OutputError.

    written: patterns of what a run writes, relative to `out`.
    """
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out}: expected a folder; got a file. Choose another --out.")
    there = [path for pattern in written for path in out.glob(pattern)]
    if there and not overwrite:
        raise OutputError(f"{there[0]}: an earlier run wrote it. Choose another --out, or add --overwrite.")
    try:
        for path in there:
            path.unlink()
        for folder in folders:
            (out / folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written ({error.strerror}). Choose another --out.") from error
