"""NPZ archives from others: every array is checked before it is read."""

import math
import tokenize
import zipfile
import zlib
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray

from ..errors import DuoSpaceNetError
from ..files import check_regular_file
from ..printable import shortened

MAX_ARCHIVE_BYTES = 2**38
MAX_TEXT_BYTES = 2**28
_MAX_HEADER_BYTES = 2**16
_SUFFIX = ".npy"
_READ_ERRORS = (
    *(zipfile.BadZipFile, zlib.error, EOFError, OSError, ValueError),
    RuntimeError,  # zipfile: an encrypted member; NotImplementedError for an unknown compression method
    *(IndexError, TypeError, tokenize.TokenError),  # numpy: a header that is not the one of an array
    MemoryError,  # numpy: a header with a shape that no memory can hold, before any data are read
)


class NpzArchive:
    """An open NPZ archive, such as `numpy.savez` writes. Arrays are read one by one, and never unpickled.

    Raises `error`, naming the file, if it is not a whole archive.
    """

    def __init__(self, path: Path, error: type[DuoSpaceNetError]) -> None:
        check_regular_file(path, MAX_ARCHIVE_BYTES, error)
        self.path, self._error = path, error
        try:
            self._file = zipfile.ZipFile(path)
        except _READ_ERRORS as cause:
            raise error(
                f"{path}: expected a whole NPZ archive, as numpy.savez writes; got none ({cause}). The file may be "
                "half-written: make or copy it again."
            ) from None
        self._members = {info.filename.removesuffix(_SUFFIX): info for info in self._file.infolist()}
        if len(self._members) != len(self._file.infolist()):
            self._file.close()
            raise error(f"{path}: expected each array once; got one twice. Make the file again.")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def names(self) -> set[str]:
        """The names of all arrays."""
        return set(self._members)

    def read(self, name: str, shape: tuple[int, ...], dtypes: tuple[str, ...]) -> NDArray:
        """Read an array of a known shape and one of some types. Raises the archive's error, naming the array."""
        largest = math.prod(shape) * max(np.dtype(dtype).itemsize for dtype in dtypes)
        array = self._read(name, largest + _MAX_HEADER_BYTES)
        if array.shape != shape or array.dtype.name not in dtypes:
            raise self._error(
                f"{self.path}: array {shortened(name)}: expected {' or '.join(dtypes)} {shape}; got "
                f"{array.dtype.name} {array.shape}. Write it in that form."
            )
        return array

    def read_text(self, name: str) -> str:
        """Read an array that is a single string. Raises the archive's error, naming the array."""
        array = self._read(name, MAX_TEXT_BYTES)
        if array.shape != () or array.dtype.kind != "U":
            raise self._error(
                f"{self.path}: array {shortened(name)}: expected a single string; got {array.dtype.name} {array.shape}."
            )
        return str(array)

    def _read(self, name: str, max_bytes: int) -> NDArray:
        info = self._members.get(name)
        if info is None:
            raise self._error(f"{self.path}: expected the array {shortened(name)}; it is missing.")
        if info.file_size > max_bytes:
            raise self._error(
                f"{self.path}: array {shortened(name)}: expected at most {max_bytes} bytes; got {info.file_size}."
            )
        try:
            with self._file.open(info) as member:
                array = np.lib.format.read_array(member, allow_pickle=False)
                member.read()  # to the end, so that the checksum is compared
                return array
        except _READ_ERRORS as cause:
            raise self._error(
                f"{self.path}: array {shortened(name)}: cannot be read ({shortened(str(cause))}). The file is damaged: "
                "make or copy it again."
            ) from None
