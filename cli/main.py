"""The command line: `duospacenet COMMAND`. Every failure ends in a message and an exit code, never a traceback.

What takes long to import is imported where an interruption is already caught.
"""

import io
import os
import signal
import sys
from contextlib import suppress

INTERRUPTED = 130
READ_OR_WRITE_FAILED = 5


def main() -> None:
    """Run a command and end the process with its exit code. SIGTERM ends it as Ctrl-C does."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that lacks a letter is no reason to fail
    interrupted = _import_commands()
    try:
        code = INTERRUPTED if interrupted else _deliver(run_app(sys.argv[1:]))
    except KeyboardInterrupt:
        code = INTERRUPTED
    for signal_number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signal_number, signal.SIG_IGN)  # what was to be done is done
    # An interruption within any exec of a string, as dataclasses do while they are imported, leaves a mark in CPython
    # by which it ends itself with SIGINT, though it was caught. The next exec takes it away.
    exec("")
    sys.exit(code)


def _import_commands() -> bool:
    """Import what the commands need; whether an interruption came meanwhile. It waits, for native modules would turn
    it into an ImportError of their own.
    """
    came: list[int] = []
    for signal_number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signal_number, lambda number, _: came.append(number))
    from . import commands  # noqa: F401

    for signal_number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signal_number, signal.default_int_handler)
    if came:
        _say("interrupted; nothing was begun")
    return bool(came)


def run_app(arguments: list[str]) -> int:
    """Run a command; returns 0 fine, 1 a check failed, 2 usage, 3 bad input data, 4 bad artifact, 5 I/O,
    6 a missing extra, 130 interrupted.
    """
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        _say("interrupted; what was finished is on disk")
        return INTERRUPTED


def _run(arguments: list[str]) -> int:
    import typer
    from typer.exceptions import TyperException

    from ..runtime.errors import DuoSpaceNetError
    from .commands import app

    try:
        code = app(arguments or ["--help"], prog_name="duospacenet", standalone_mode=False) or 0
    except typer.Abort:
        raise KeyboardInterrupt from None
    except TyperException as error:
        _say(f"error: {error.format_message().rstrip('.')}. See duospacenet COMMAND --help.")
        return error.exit_code
    except DuoSpaceNetError as error:
        _say(f"error: {error}")
        return error.exit_code
    except OSError as error:
        _say(f"error: {error.filename or 'standard output'}: {error.strerror or error}")
        return READ_OR_WRITE_FAILED
    except Exception as error:
        if os.environ.get("DUOSPACENET_TRACEBACK"):
            raise
        _say(f"internal error: {type(error).__name__}: {error}\nDUOSPACENET_TRACEBACK=1 shows where; please report it.")
        return 1
    if code == INTERRUPTED:
        raise KeyboardInterrupt
    return code


def _say(message: str) -> None:
    """To stderr; where nobody listens there is nothing more to say."""
    with suppress(OSError, AttributeError):
        sys.stderr.write(message + "\n")
        sys.stderr.flush()


def _deliver(code: int) -> int:
    """Let what was printed reach its reader, or say that it did not."""
    if sys.stdout is None:  # closed by the caller
        return code
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python tries again, and fails again
        if code == 0:
            _say(f"error: standard output: {error.strerror}")
        return code or READ_OR_WRITE_FAILED
    return code


if __name__ == "__main__":
    main()
