"""Commands in their own processes, for tests of exit codes, output and signals."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence

COMMAND = [sys.executable, "-m", "duospacenet.cli.main"]

_started: list[subprocess.Popen] = []


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
    return popen(command, **piped | options)


def start_until_import(arguments: Sequence[object], num_imports: int) -> subprocess.Popen:
    """Start `duospacenet ARGUMENTS`, and return when it has imported `num_imports` modules while it catches signals.

    Returns at the end of the process if it imports fewer modules. The process reports its imports on stderr.
    """
    command = [sys.executable, "-X", "importtime", *COMMAND[1:], *map(str, arguments)]
    process = popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    while line := process.stderr.readline():
        if line.rstrip().endswith("duospacenet.cli.standard_streams"):  # main's last import before it catches signals
            break
    for _ in range(num_imports):
        process.stderr.readline()
    return process


def popen(command: Sequence[str], **options) -> subprocess.Popen:
    """Start a command that `kill_leftovers` ends if the test does not.

    SIGINT and SIGHUP have their default action in the new process. A suite that runs in the background or under `nohup`
    ignores them, and its children would inherit that.
    """
    previous = {number: signal.signal(number, signal.SIG_DFL) for number in (signal.SIGINT, signal.SIGHUP)}
    try:
        process = subprocess.Popen(command, **options)
    finally:
        for number, handler in previous.items():
            signal.signal(number, handler)
    _started.append(process)
    return process


def kill_leftovers() -> None:
    """Kill the processes that a failed test has left running."""
    while _started:
        process = _started.pop()
        if process.poll() is None:
            process.kill()
            process.wait()


def wait_for(condition: Callable[[], bool], timeout_s: float = 60) -> None:
    """Wait until the condition holds. Fails after the time-out."""
    start_s = time.monotonic()
    while not condition():
        assert time.monotonic() - start_s < timeout_s
        time.sleep(0.02)
