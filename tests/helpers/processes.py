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


def start_until_import(arguments: Sequence[object], num_imports: int) -> subprocess.Popen:
    """Start `duospacenet ARGUMENTS`, and return when it has imported `num_imports` modules while it catches signals.

    Returns at the end of the process if it imports fewer modules. The process reports its imports on stderr.
    """
    command = [sys.executable, "-X", "importtime", *COMMAND[1:], *map(str, arguments)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    while line := process.stderr.readline():
        if line.rstrip().endswith("duospacenet.cli.standard_streams"):  # main's last import before it catches signals
            break
    for _ in range(num_imports):
        process.stderr.readline()
    return process


def wait_for(condition: Callable[[], bool], timeout_s: float = 60) -> None:
    """Wait until the condition holds. Fails after the time-out."""
    start_s = time.monotonic()
    while not condition():
        assert time.monotonic() - start_s < timeout_s
        time.sleep(0.02)
