"""stdout and stderr of a command, also when the caller or a reader has closed them."""

import errno
import io
import os
import sys


def prepare_standard_streams() -> None:
    """Make stdout and stderr writable for the rest of the process.

    A stream that the caller closed (`>&-`) writes to /dev/null. Output is dropped once its reader has gone, so that
    the command still finishes and ends with its own exit code. A character that the encoding lacks becomes "?".
    """
    _open_closed_descriptors()
    sys.stdout = sys.__stdout__ = _droppable(sys.stdout, 1)  # type: ignore[misc]
    sys.stderr = sys.__stderr__ = _droppable(sys.stderr, 2)  # type: ignore[misc]


class DroppableOutput(io.TextIOWrapper):
    """Text output that continues to /dev/null after `| head -1` has ended, or after its terminal was closed."""

    def __init__(self, stream: io.TextIOWrapper) -> None:
        self._was_terminal = stream.isatty()
        super().__init__(
            stream.detach(), encoding=stream.encoding, errors="replace", line_buffering=stream.line_buffering
        )

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError as error:
            self._drop_or_raise(error)
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            self._drop_or_raise(error)

    def _drop_or_raise(self, error: OSError) -> None:
        """Redirect to /dev/null after the reader or the terminal has closed. Raise other errors, e.g. a full disk."""
        if error.errno != errno.EPIPE and not (error.errno == errno.EIO and self._was_terminal):
            raise error
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, self.fileno())
        os.close(null)
        super().flush()


def _open_closed_descriptors() -> None:
    """Open descriptors 0 to 2 on /dev/null where they are closed: a file opened later would take their numbers."""
    for descriptor in range(3):
        try:
            os.fstat(descriptor)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)  # open() returns the lowest free descriptor


def _droppable(stream: object, descriptor: int) -> io.TextIOWrapper:
    if stream is None:  # Python found the descriptor closed
        stream = io.TextIOWrapper(io.BufferedWriter(io.FileIO(descriptor, "w", closefd=False)), encoding="utf-8")
    assert isinstance(stream, io.TextIOWrapper)
    return DroppableOutput(stream)
