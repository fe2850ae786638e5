"""The entry point of `duospacenet COMMAND`. Every failure ends with a message and an exit code, never a traceback."""

import os
import sys

from ..runtime.errors import (
    INTERNAL_ERROR_EXIT_CODE,
    INTERRUPTED_EXIT_CODE,
    DuoSpaceNetError,
    OutputError,
)
from ..runtime.process_errors import OtherProcessError
from .cache_folders import keep_temporary_folder_clean
from .console import print_error
from .interruptions import catch_interruptions, ignore_interruptions
from .standard_streams import prepare_standard_streams

RESUMABLE = ("run", "batch", "train")  # the commands with --resume


def main() -> None:
    """Run a command and end the process with its exit code."""
    prepare_standard_streams()
    keep_temporary_folder_clean()
    catch_interruptions()
    try:
        code = _flush_stdout(run_app(sys.argv[1:]))
    except KeyboardInterrupt:
        code = INTERRUPTED_EXIT_CODE
    ignore_interruptions()
    # A KeyboardInterrupt inside an exec of a string (dataclasses and namedtuples run one) sets a flag in CPython, by
    # which the process ends with SIGINT even though the exception was caught. The next exec clears the flag.
    exec("")
    sys.exit(code)


def run_app(arguments: list[str]) -> int:
    """Run a command and return its exit code; `runtime/errors.py` lists the codes."""
    try:
        return _run(arguments)
    except KeyboardInterrupt:
        resumable = arguments and arguments[0] in RESUMABLE
        advice = "; finished results are on disk; add --resume to continue" if resumable else ""
        if _is_first_process():
            print_error(f"interrupted{advice}")
        return INTERRUPTED_EXIT_CODE


def _run(arguments: list[str]) -> int:
    import typer
    from typer.exceptions import TyperException

    from .commands import app

    try:
        code = app(arguments or ["--help"], prog_name="duospacenet", standalone_mode=False) or 0
    except typer.Abort:
        raise KeyboardInterrupt from None
    except TyperException as error:
        message = error.format_message()
        stop = "" if message.endswith((".", "?")) else "."
        context = getattr(error, "ctx", None)
        command = context.command_path if context else "duospacenet"
        if _is_first_process():
            print_error(f"error: {message}{stop} See `{command} --help`.")
        return error.exit_code
    except OtherProcessError as error:
        # An interruption of all processes may come to another one first.
        if error.exit_code == INTERRUPTED_EXIT_CODE:
            raise KeyboardInterrupt from None
        return error.exit_code
    except DuoSpaceNetError as error:
        print_error(f"error: {error}")
        return error.exit_code
    except OSError as error:
        print_error(f"error: {error.filename or 'standard output'}: {error.strerror or error}")
        return OutputError.exit_code
    except Exception as error:
        if os.environ.get("DUOSPACENET_TRACEBACK"):
            raise
        print_error(
            f"internal error: {type(error).__name__}: {error}\n"
            "This is a bug of duospacenet. DUOSPACENET_TRACEBACK=1 shows the traceback; please report it."
        )
        return INTERNAL_ERROR_EXIT_CODE
    if code == INTERRUPTED_EXIT_CODE:  # typer's answer to a KeyboardInterrupt
        raise KeyboardInterrupt
    return code


def _is_first_process() -> bool:
    """Whether this process reports what all processes have in common. torchrun starts several with the same command."""
    return "TORCHELASTIC_RUN_ID" not in os.environ or os.environ.get("RANK") == "0"


def _flush_stdout(code: int) -> int:
    """Write out what was printed. Returns the exit code, which becomes that of I/O errors if stdout is full."""
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # or Python reports the error again at its end
        if code == 0:
            print_error(f"error: standard output: {error.strerror}")
        return code or OutputError.exit_code
    return code


if __name__ == "__main__":
    main()
