"""Commands in their own processes, for tests of exit codes, output and signals."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence

COMMAND = [sys.executable, "-m", "duospacenet.cli.main"]


def call(arguments: Sequence[object], **options) -> subprocess.CompletedProcess:
    """Run `duospacenet ARGUMENTS` and wait for its end. The output is captured as text.

    options: of `subprocess.run`; they override the defaults.
    """
    command = [*COMMAND, *map(str, arguments)]
    return subprocess.run(command, **{"capture_output": True, "text": True, "check": False} | options)


def start(arguments: Sequence[object], **options) -> subprocess.Popen:
    """Start `duospacenet ARGUMENTS` and return without waiting.

    options: of `subprocess.Popen`; they override the defaults.
    """
    command = [*COMMAND, *map(str, arguments)]
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "env": os.environ}
    return subprocess.Popen(command, **piped | options)


def wait_for(condition: Callable[[], bool], timeout_s: float = 60) -> None:
    """Wait until the condition holds. Fails after the time-out."""
    start_s = time.monotonic()
    while not condition():
        assert time.monotonic() - start_s < timeout_s
        time.sleep(0.02)
