"""The index file of a nuScenes root: an npz file in the cache folder, built once from the tables.

The cache folder is `$DUOSPACENET_CACHE`, or `duospacenet` in `$XDG_CACHE_HOME` or `~/.cache`. An index is rebuilt if a
table has another size or time of change, if the file is damaged, and for another version of its format.
"""

import hashlib
import os
import zipfile
import zlib
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from ...runtime.errors import InputError, OutputError
from ...runtime.files import atomic_path, output_errors
from ...runtime.progress import Progress, no_progress
from .index_builder import build_index
from .index_records import INDEX_FORMAT, Index, IndexSummary, SceneIndex
from .table_set import read_stamps

CACHE_VARIABLE: Final = "DUOSPACENET_CACHE"

_DAMAGE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, msgspec.MsgspecError)


class IndexFile:
    """An open index. Scenes are read when they are requested, and their checksums are checked then.

    path: of the file.
    summary: of the index.
    """

    def __init__(self, path: Path) -> None:
        """Open an index. Raises one of several exceptions if it is damaged, see `open_index`."""
        self.path = path
        self._arrays = np.load(path, allow_pickle=False)
        self.summary = IndexSummary.from_array(self._arrays["summary"])

    def scene(self, number: int) -> SceneIndex:
        """Read a scene, by its number in the summary. Raises InputError if the file is damaged."""
        return SceneIndex(*(self._read(f"{number}/{name}") for name in SceneIndex._fields))

    def tokens(self) -> NDArray[np.bytes_]:
        """Read the sample tokens of all scenes. Raises InputError if the file is damaged."""
        return self._read("tokens")

    def check(self) -> None:
        """Check the checksums of the whole file. Raises BadZipFile or another exception if it is damaged."""
        with zipfile.ZipFile(self.path) as archive:
            if archive.testzip() is not None:
                raise zipfile.BadZipFile

    def _read(self, name: str) -> NDArray:
        try:
            return self._arrays[name]
        except _DAMAGE:
            raise InputError(
                f"{self.path}: expected an undamaged index of a nuScenes root; got damage in {name}. "
                "Remove the file; it is built again."
            ) from None


def open_index(folder: Path, progress: Progress = no_progress) -> IndexFile:
    """Open the index of the version folder. It is built first if there is none, or if it does not fit the tables.

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
    except _DAMAGE:
        index = None
    if index is None or index.summary.sha256 != sha256:
        raise InputError(
            f"{path}: expected the index that this command has opened; got another one, or none. "
            "Has the nuScenes root changed? Start the command again."
        )
    return index


def index_path(folder: Path) -> Path:
    """Return the path of the index of a version folder. It may not exist."""
    folder = folder.resolve()
    digest = hashlib.sha256(os.fsencode(folder)).hexdigest()[:16]
    return _cache_folder() / "nuscenes" / f"{folder.name}-{digest}.npz"


def _cache_folder() -> Path:
    if folder := os.environ.get(CACHE_VARIABLE):
        return Path(folder)
    base = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG specification says that relative paths are to be ignored.
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".cache") / "duospacenet"


def _open_current(path: Path, folder: Path) -> IndexFile | None:
    """Open the index if it is undamaged and was built from the tables as they are now."""
    stamps = read_stamps(folder)
    try:
        index = IndexFile(path)
        index.check()
    except _DAMAGE:
        return None
    summary = index.summary
    return index if summary.index_format == INDEX_FORMAT and summary.stamps == stamps else None


def _write_index(path: Path, index: Index) -> None:
    """Write an index, completely or not at all. Two processes may write the same one."""
    arrays: dict[str, NDArray] = {"summary": index.summary.to_array(), "tokens": index.tokens}
    for number, scene in enumerate(index.scenes):
        arrays |= {f"{number}/{name}": array for name, array in scene._asdict().items()}
    try:
        with output_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            np.savez(temporary, allow_pickle=False, **arrays)
    except OutputError as error:
        raise OutputError(
            f"{error}. The index of a nuScenes root is kept there. Set {CACHE_VARIABLE} to a writable folder."
        ) from error
