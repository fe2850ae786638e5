"""Ctrl-C, SIGTERM and SIGHUP: each ends a command by KeyboardInterrupt, so that its clean-up runs."""

import os
import signal
import threading
from types import FrameType

from ..runtime.termination import terminate_calls

_RETRY_AFTER_S = 0.02


def catch_interruptions() -> None:
    """Raise KeyboardInterrupt on SIGINT, SIGTERM and SIGHUP. SIGHUP stays ignored if it is, as under `nohup`.

    A call of onnxruntime that is in progress ends early.
    """
    _start_watcher()
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


def _start_watcher() -> None:
    """Start a thread that ends onnxruntime's calls on a signal.

    Python's handlers wait until the main thread returns from onnxruntime. Before that, Python writes the signal's
    number to the wake-up descriptor, at once and in any thread.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    # A forked process has its parent's descriptor, but its signals are not the parent's.
    os.register_at_fork(after_in_child=lambda: signal.set_wakeup_fd(-1))
    numbers = frozenset({*_interruptions(), signal.SIGALRM})
    threading.Thread(target=_watch, args=(reader, numbers), name="signal watcher", daemon=True).start()


def _watch(reader: int, numbers: frozenset[signal.Signals]) -> None:
    # A signal that the main thread blocks must stay pending, and not be delivered to this thread.
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())
    while received := os.read(reader, 64):
        if numbers.intersection(received):
            terminate_calls()
