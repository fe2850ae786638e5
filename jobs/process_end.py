"""Why a process that this one has started has ended, in a few words."""

import os
import signal
from typing import IO

from ..runtime.printable import printable

_LAST_BYTES = 2**16  # of the log; a process may have written warnings for hours
_MAX_CHARACTERS = 200


def describe_end(status: int, log: IO[bytes]) -> str:
    """Return the signal that ended the process, or the last line that it wrote to stderr.

    status: its exit code; negative for a signal. log: the file that its stderr went to.
    """
    if status < 0:
        memory = "; the machine may have too little memory" if status == -signal.SIGKILL else ""
        return f"signal {-status}{memory}"
    size = log.seek(0, os.SEEK_END)
    log.seek(max(0, size - _LAST_BYTES))
    lines = log.read().decode(errors="replace").strip().splitlines()
    return printable(lines[-1])[:_MAX_CHARACTERS] if lines else f"exit code {status}"
