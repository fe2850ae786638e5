"""The folder of files that are built once from a nuScenes root: the index of its tables, and the geometry of its maps.

The cache folder is `$DUOSPACENET_CACHE`, or `duospacenet` in `$XDG_CACHE_HOME` or `~/.cache`.
"""

import hashlib
import os
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import msgspec
import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from ...runtime.errors import OutputError
from ...runtime.files import atomic_path, output_errors

CACHE_VARIABLE: Final = "DUOSPACENET_CACHE"

# What `np.load` and reading its arrays raise if a file is missing, damaged, or not what was written.
DAMAGE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error, msgspec.MsgspecError)


def cache_path(source: Path, name: str) -> Path:
    """The path of the npz file for a file or folder of a root. It may not exist.

    name: the beginning of its name.
    """
    digest = hashlib.sha256(os.fsencode(os.path.realpath(source))).hexdigest()[:16]
    return _cache_folder() / "nuscenes" / f"{name}-{digest}.npz"


def open_arrays(path: Path) -> NpzFile:
    """Open an npz file. Raises one of the exceptions DAMAGE if there is no such regular file, or it is damaged."""
    if not path.is_file():
        raise FileNotFoundError  # opening a named pipe would wait for a writer
    arrays = np.load(path, allow_pickle=False)
    if not isinstance(arrays, NpzFile):
        raise zipfile.BadZipFile
    return arrays


def write_arrays(path: Path, arrays: Mapping[str, NDArray]) -> None:
    """Write an npz file, completely or not at all. Two processes may write the same one.

    Raises OutputError if it cannot be written.
    """
    try:
        with output_errors(path):
            path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            np.savez(temporary, allow_pickle=False, **arrays)
    except OutputError as error:
        raise OutputError(
            f"{error}. What is built from a nuScenes root is kept there. Set {CACHE_VARIABLE} to a writable folder."
        ) from error


def _cache_folder() -> Path:
    if folder := os.environ.get(CACHE_VARIABLE):
        return Path(folder)
    base = os.environ.get("XDG_CACHE_HOME", "")
    # The XDG specification says that relative paths are to be ignored.
    return (Path(base) if Path(base).is_absolute() else Path.home() / ".cache") / "duospacenet"
