"""The stdout of a process that replies on it."""

import os
from typing import IO


def private_stdout() -> IO[str]:
    """Keep stdout for replies. Whatever a library prints goes to stderr."""
    replies = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    return replies
