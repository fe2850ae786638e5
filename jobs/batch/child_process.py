"""A process that a batch has started: a worker, or the driver of Ray. See `json_lines.py`."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from ..error_reply import check_reply
from ..process_end import describe_end


class ProcessLostError(Exception):
    """The process has ended. The message says why, in a few words."""


class ChildProcess:
    """A process of a module of this package. Requests and replies are JSON values."""

    def __init__(self, module: str, arguments: list[str], environment: Mapping[str, str]) -> None:
        """Start the process. module: its name in this package. environment: all variables of the process."""
        # -P: no module of the current folder is imported
        command = [sys.executable, "-P", "-m", f"{__package__}.{module}", *arguments]
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=environment,
            start_new_session=True,  # Ctrl-C ends the batch, which then ends this process by closing its stdin
        )

    def send(self, request: Any) -> None:
        """Send a request. Raises ProcessLostError."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(request) + "\n")
            self._process.stdin.flush()
        except (OSError, ValueError):  # ValueError: `end` was called
            raise ProcessLostError(self._cause_of_death()) from None

    def receive(self) -> dict[str, Any]:
        """Wait for the next reply. Raises the DuoSpaceNetError of the process, and ProcessLostError."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.endswith("\n"):  # a killed process may leave a part of a line
            raise ProcessLostError(self._cause_of_death())
        reply = json.loads(line)
        check_reply(reply)
        return reply

    def end(self) -> None:
        """Ask the process to end. Do not wait."""
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()

    def wait(self, timeout_s: float) -> None:
        """Wait until the process has ended. Kill it after the time-out."""
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._kill()

    def close(self) -> None:
        """Kill the process if it has not ended, and close its files."""
        self._kill()
        self.end()
        assert self._process.stdout is not None
        self._process.stdout.close()
        self._log.close()

    def _kill(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()

    def _cause_of_death(self) -> str:
        return describe_end(self._process.wait(), self._log)
