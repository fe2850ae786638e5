"""The index file of a nuScenes root: an npz file in the cache folder, built once from the tables.

An index is rebuilt if a table has another size or time of change, if the file is damaged, and for another version of
its format.
"""

import os
import zipfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...runtime.errors import InputError
from ...runtime.progress import Progress, no_progress
from .cache_folder import DAMAGE, cache_path, open_arrays, write_arrays
from .index_builder import build_index
from .index_records import BOX, CALIBRATION, FRAME, IMAGE, INDEX_FORMAT, Index, IndexSummary, SceneIndex
from .table_set import read_stamps


class IndexFile:
    """An open index. Scenes are read when they are requested, and their checksums are checked then.

    path: of the file.
    summary: of the index.
    """

    def __init__(self, path: Path) -> None:
        """Open an index. Raises one of the exceptions DAMAGE if it is damaged."""
        self.path = path
        self._arrays = open_arrays(path)
        self.summary = IndexSummary.from_array(self._arrays["summary"])

    def scene(self, number: int) -> SceneIndex:
        """Read a scene, by its number in the summary. Raises InputError if the file is damaged."""
        types = (FRAME, IMAGE, None, CALIBRATION, BOX)
        names = (f"{number}/{field}" for field in SceneIndex._fields)
        return SceneIndex(*(self._read(name, dtype) for name, dtype in zip(names, types, strict=True)))

    def tokens(self) -> NDArray[np.bytes_]:
        """Read the sample tokens of all scenes. Raises InputError if the file is damaged."""
        return self._read("tokens")

    def check(self) -> None:
        """Check the checksums of the whole file. Raises one of the exceptions DAMAGE if it is damaged."""
        if self._arrays.zip is None or self._arrays.zip.testzip() is not None:
            raise zipfile.BadZipFile

    def _read(self, name: str, dtype: np.dtype | None = None) -> NDArray:
        """Read a one-dimensional array of this type; of bytes without one."""
        try:
            array: NDArray = self._arrays[name]
            if array.ndim != 1 or (array.dtype.kind != "S" if dtype is None else array.dtype != dtype):
                raise ValueError
            return array
        except DAMAGE:
            raise InputError(
                f"{self.path}: expected an undamaged index of a nuScenes root; got damage in {name}. "
                "Remove the file; it is built again."
            ) from None


def open_index(folder: Path, progress: Progress = no_progress) -> IndexFile:
    """Open the index of the version folder. Builds it first if it is missing or does not fit the tables.

    Raises InputError for tables that are missing, damaged or inconsistent, and OutputError if the index cannot be
    written.
    """
    path = index_path(folder)
    index = _open_current(path, folder)
    if index is None:
        _write_index(path, build_index(folder, progress))
        index = IndexFile(path)
    return index


def reopen_index(path: Path, sha256: str) -> IndexFile:
    """Open an index that another process has opened. Raises InputError if it is not the same any more.

    sha256: of its summary.
    """
    try:
        index = IndexFile(path)
    except DAMAGE:
        index = None
    if index is None or index.summary.sha256 != sha256:
        raise InputError(
            f"{path}: expected the index that this command has opened; got another one, or none. "
            "Has the nuScenes root changed? Start the command again."
        )
    return index


def index_path(folder: Path) -> Path:
    """Return the path of the index of a version folder. It may not exist."""
    return cache_path(folder, Path(os.path.realpath(folder)).name)


def _open_current(path: Path, folder: Path) -> IndexFile | None:
    """Open the index if it is undamaged and was built from the tables as they are now."""
    stamps = read_stamps(folder)
    try:
        index = IndexFile(path)
        index.check()
    except DAMAGE:
        return None
    summary = index.summary
    return index if summary.index_format == INDEX_FORMAT and summary.stamps == stamps else None


def _write_index(path: Path, index: Index) -> None:
    arrays: dict[str, NDArray] = {"summary": index.summary.to_array(), "tokens": index.tokens}
    for number, scene in enumerate(index.scenes):
        arrays |= {f"{number}/{name}": array for name, array in scene._asdict().items()}
    write_arrays(path, arrays)
