"""Ctrl-C, SIGTERM and SIGHUP: each ends a command by KeyboardInterrupt, so that its clean-up runs."""

import signal
from types import FrameType

_RETRY_AFTER_S = 0.02


def catch_interruptions() -> None:
    """Raise KeyboardInterrupt on SIGINT, SIGTERM and SIGHUP. SIGHUP stays ignored if it is, as under `nohup`."""
    for number in _interruptions():
        signal.signal(number, _interrupt)
    signal.signal(signal.SIGALRM, _interrupt)


def ignore_interruptions() -> None:
    """Ignore all further interruptions: the command has finished."""
    for number in (*_interruptions(), signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)


def _interruptions() -> list[signal.Signals]:
    hangup_ignored = signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    return [signal.SIGINT, signal.SIGTERM, *([] if hangup_ignored else [signal.SIGHUP])]


def _interrupt(_signal_number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, but not inside an import statement: try again a little later.

    numpy's and torch's native modules turn an exception during their import into an ImportError of their own.
    """
    if _is_importing(frame):
        signal.setitimer(signal.ITIMER_REAL, _RETRY_AFTER_S)
    else:
        raise KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False
