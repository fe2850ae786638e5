"""Why a process has ended, in a few words."""

import io
import signal

import pytest

from duospacenet.jobs.process_end import describe_end


@pytest.mark.parametrize(
    ("status", "log", "text"),
    [
        (-signal.SIGKILL, b"", "signal 9; the machine may have too little memory"),
        (-signal.SIGSEGV, b"a warning\n", "signal 11"),
        (3, b"", "exit code 3"),
        (1, b"Traceback\nMemoryError: \x1b[2J\n", r"MemoryError: \x1b[2J"),
        (1, b"\xff" * 10**6 + b"\nValueError: large\n\n", "ValueError: large"),
    ],
)
def test_the_end_of_a_process_is_described(status, log, text):
    assert describe_end(status, io.BytesIO(log)) == text
