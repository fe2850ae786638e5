"""A file that a library in another language writes to, which does not report failed writes."""

import os
from pathlib import Path

from ..runtime.errors import OutputError
from ..runtime.files import output_errors


class CheckedFile:
    """A binary file that remembers the first failed write, for example on a full disk. Later writes do nothing.

    The library would print an error for each failed write and go on. So a failed write reports success to it, and
    positions go on as if it had succeeded.
    """

    def __init__(self, path: Path, name: Path) -> None:
        """path: a new file. name: for messages. Raises OutputError if it cannot be opened."""
        self._name = name
        self._error: OSError | None = None
        self._position = self._end = 0
        with output_errors(name):
            self._file = path.open("xb", buffering=0)

    def write(self, data: bytes | bytearray) -> int:
        """Write bytes at the position, and return their number."""
        rest = memoryview(data)
        try:
            while rest and self._error is None:
                rest = rest[self._file.write(rest) :]
        except OSError as error:
            self._error = error
        self._position += len(data)
        self._end = max(self._end, self._position)
        return len(data)

    def seek(self, offset: int, whence: int = os.SEEK_SET) -> int:
        """Move to a position, and return it."""
        self._position = offset + {os.SEEK_SET: 0, os.SEEK_CUR: self._position, os.SEEK_END: self._end}[whence]
        if self._error is None:
            self._file.seek(self._position)
        return self._position

    def flush(self) -> None:
        """Nothing to do: the file is not buffered."""

    def check(self) -> None:
        """Raise OutputError if a write has failed."""
        if self._error is not None:
            raise OutputError(f"cannot write {self._name}: {self._error.strerror}") from self._error

    def close(self) -> None:
        """Close the file."""
        self._file.close()
