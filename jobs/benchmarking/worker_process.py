"""Starts the process that measures one target, and talks to it."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any

from ..error_reply import check_reply
from ..process_end import describe_end
from .targets import Target

COMMAND = [sys.executable, "-P", "-m", f"{__package__}.worker"]  # -P: no module of the current folder is imported


class WorkerFailedError(Exception):
    """The process of a target has ended. target: its name. The message says why, in one line."""

    def __init__(self, target: str, message: str) -> None:
        super().__init__(message)
        self.target = target


class WorkerProcess:
    """The process of one target. A context manager: the process is killed at its end."""

    def __init__(self, target: Target, temporary_dir: Path) -> None:
        """Start the process. temporary_dir: for files of the libraries, such as compiled code."""
        self.target = target
        self._log = tempfile.TemporaryFile(dir=temporary_dir)  # noqa: SIM115 - closed by __exit__
        threads = str(target.threads)
        environment = {"OMP_NUM_THREADS": threads, "TORCHINDUCTOR_CACHE_DIR": str(temporary_dir / "inductor")}
        self._process = subprocess.Popen(
            COMMAND,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            text=True,
            env=os.environ | environment | {"TMPDIR": str(temporary_dir)},
            start_new_session=True,  # Ctrl-C ends the benchmark, which reports what it has, and kills this process
        )
        self._send(target.model_dump_json())

    def __enter__(self) -> "WorkerProcess":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)  # also the processes that torch.compile starts
        self._process.communicate()
        self._log.close()

    def call(self, method: str, **arguments: Any) -> Any:
        """Call a method of the process's `Worker` and return its result.

        Raises the DuoSpaceNetError that the method raised, and WorkerFailedError if the process has ended.
        """
        self._send(json.dumps({"method": method, **arguments}))
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise WorkerFailedError(self.target.name, self._cause_of_death())
        reply = json.loads(line)
        check_reply(reply)
        return reply["result"]

    def _send(self, line: str) -> None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(line + "\n")
            self._process.stdin.flush()
        except BrokenPipeError:
            raise WorkerFailedError(self.target.name, self._cause_of_death()) from None

    def _cause_of_death(self) -> str:
        return describe_end(self._process.wait(), self._log)
