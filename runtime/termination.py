"""Ends the calls of an engine from another thread.

While an engine runs a graph, Python's signal handlers must wait for the end of the call. So Ctrl-C would have no
effect for seconds. onnxruntime and OpenVINO end a call early if another thread asks for it.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_stops: dict[int, Callable[[], None]] = {}  # of the calls in progress, by id; one dict operation is atomic in Python


def terminate_calls() -> None:
    """End all calls of an engine that are in progress, in any thread. Each raises KeyboardInterrupt in its thread.

    A run ends after its current operator, and the loading of a graph by onnxruntime after its optimisation step.
    """
    for stop in list(_stops.values()):
        stop()


@contextmanager
def terminable(stop: Callable[[], None]) -> Iterator[None]:
    """Let `terminate_calls` end the call in the block.

    stop: asks the engine to end the call, so that it fails soon. It is called from another thread.
    Raises KeyboardInterrupt in place of the call's own exception if the call was stopped.
    """
    stopped = False

    def stop_call() -> None:
        nonlocal stopped
        stopped = True
        stop()

    _stops[id(stop_call)] = stop_call
    try:
        yield
    except Exception:
        if stopped:
            raise KeyboardInterrupt from None
        raise
    finally:
        del _stops[id(stop_call)]
