"""The tables of one version of a nuScenes root: which there must be, and whether they have changed."""

import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from ...runtime.errors import InputError
from ...runtime.files import change_stamp
from ...runtime.progress import Progress
from .table import NumberedRow, RowType, Table, check_exists

TABLE_NAMES: Final = (
    "attribute",
    "calibrated_sensor",
    "category",
    "ego_pose",
    "instance",
    "log",
    "sample",
    "sample_annotation",
    "sample_data",
    "scene",
    "sensor",
    "visibility",
)

Stamps = dict[str, tuple[int, int]]


def read_stamps(folder: Path) -> Stamps:
    """Return the stamp of each table in a version folder, which changes when the table is written.

    Raises InputError, naming the table, if one is missing.
    """
    stamps = {}
    for name in TABLE_NAMES:
        path = table_path(folder, name)
        check_exists(path)
        try:
            status = path.stat()
        except OSError as error:
            raise InputError(f"{path}: cannot be read ({error.strerror}).") from None
        stamps[name] = change_stamp(status)
    return stamps


class TableSet:
    """Opens the tables of a version folder, and keeps the hashes of their contents."""

    def __init__(self, folder: Path, progress: Progress) -> None:
        self._progress = progress
        self._folder = folder
        self._hashes: dict[str, str] = {}

    def open(self, name: str, row_type: type[RowType]) -> Table[RowType]:
        """Read a table. Raises InputError, naming the file, if it is missing, or is not a JSON array."""
        table = Table(table_path(self._folder, name), row_type)
        self._hashes[name] = table.sha256
        return table

    def rows(self, table: Table[RowType]) -> Iterator[NumberedRow[RowType]]:
        """Yield the rows of a large table, and show the progress in percent."""
        # A progress bar takes longer for one step than a row does.
        step = max(1, len(table) // 100)
        for start in self._progress(range(0, len(table), step), f"index {table.path.stem}"):
            yield from table.rows(start, start + step)

    @property
    def sha256(self) -> str:
        """The hash of the hashes of all tables that have been opened."""
        lines = (f"{name} {self._hashes[name]}\n" for name in sorted(self._hashes))
        return hashlib.sha256("".join(lines).encode()).hexdigest()


def table_path(folder: Path, name: str) -> Path:
    """Return the path of a table."""
    return folder / f"{name}.json"
