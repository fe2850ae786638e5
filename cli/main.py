"""The command line: `duospacenet COMMAND`. Every failure ends in a message and an exit code, never a traceback."""

import io
import os
import signal
import sys

import typer
from typer.exceptions import TyperException

from ..runtime.errors import DuoSpaceNetError
from . import check_rig, demo, export, inspect, parity, run
from .console import say

INTERRUPTED = 130
READ_OR_WRITE_FAILED = 5

app = typer.Typer(
    name="duospacenet",
    help="DuoSpaceNet out of PyTorch: export to ONNX, run on a CPU, prove it equal.",
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.command("demo")(demo.demo)
app.command("export")(export.export)
app.command("run")(run.run)
app.command("parity")(parity.parity)
app.command("inspect")(inspect.inspect)
app.command("check-rig")(check_rig.check_rig)


def main() -> None:
    """Run a command and end the process with its exit code. SIGTERM ends it as Ctrl-C does."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal that lacks a letter is no reason to fail
    sys.exit(_deliver(run_app(sys.argv[1:])))


def run_app(arguments: list[str]) -> int:
    """Run a command; returns 0 fine, 1 a check failed, 2 usage, 3 bad input data, 4 bad artifact, 5 I/O,
    6 a missing extra, 130 interrupted.
    """
    try:
        code = app(arguments or ["--help"], prog_name="duospacenet", standalone_mode=False) or 0
    except (typer.Abort, KeyboardInterrupt):
        code = INTERRUPTED
    except TyperException as error:
        say(f"error: {error.format_message().rstrip('.')}. See duospacenet COMMAND --help.")
        return error.exit_code
    except DuoSpaceNetError as error:
        say(f"error: {error}")
        return error.exit_code
    except OSError as error:
        say(f"error: {error.filename or 'file'}: {error.strerror or error}")
        return READ_OR_WRITE_FAILED
    except Exception as error:
        if os.environ.get("DUOSPACENET_TRACEBACK"):
            raise
        say(f"internal error: {type(error).__name__}: {error}\nDUOSPACENET_TRACEBACK=1 shows where; please report it.")
        return 1
    if code == INTERRUPTED:
        say("interrupted; what was finished is on disk")
    return code


def _deliver(code: int) -> int:
    """Let what was printed reach its reader, or say that it did not."""
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python tries again, and fails again
        say(f"error: standard output: {error.strerror}")
        return code or READ_OR_WRITE_FAILED
    return code


if __name__ == "__main__":
    main()
