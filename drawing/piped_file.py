"""A file that native code writes through a pipe, so that a failed write is an exception here.

rerun writes files in a background thread. If a write fails, this thread ends, and the next flush can hang. The pipe
takes all bytes, even if the disk is full.
"""

import os
from pathlib import Path
from threading import Thread

CHUNK_BYTES = 1 << 20


class PipedFile:
    """A new file with what is written to `pipe_path`. Linux only."""

    def __init__(self, path: Path) -> None:
        """Raises OSError if the file exists or cannot be created."""
        self._file = path.open("xb", buffering=0)
        self._error: OSError | None = None
        source, self._pipe = os.pipe()
        self._thread = Thread(target=self._copy, args=(source,), daemon=True)
        self._thread.start()

    @property
    def pipe_path(self) -> str:
        """The name of the pipe in this process. Its writer closes it before `close`."""
        return f"/proc/self/fd/{self._pipe}"

    def check(self) -> None:
        """Raises the OSError of an earlier write."""
        if self._error is not None:
            raise self._error

    def close(self) -> None:
        """Complete the file. Raises OSError if a write failed. A second call does nothing else."""
        if self._pipe >= 0:
            os.close(self._pipe)
            self._pipe = -1
            self._thread.join()
            self._file.close()
        self.check()

    def _copy(self, source: int) -> None:
        """Copy the pipe until its writers have closed it. After an error its bytes are dropped."""
        with open(source, "rb", buffering=0) as pipe:
            while content := pipe.read(CHUNK_BYTES):
                try:
                    while content and self._error is None:
                        content = content[self._file.write(content) :]
                except OSError as error:
                    self._error = error
