"""Loads the next frame of a source in a thread, while the caller processes the current one."""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from ..runtime.frame import Frame

Item = TypeVar("Item")


@contextmanager
def prefetch(load: Callable[[Item], Frame], items: Iterable[Item]) -> Iterator[Iterator[Frame]]:
    """Yield the frames of `items` in order: `with prefetch(source.frame, indices) as frames`.

    One thread calls `load`. It is at most one frame ahead of the caller, so memory grows by one frame.
    An exception of `load` is raised when its frame is requested, and no later frame is loaded.
    At the end of the block, the thread has ended. A call of `load` in progress is completed before that.
    """
    thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="prefetch")
    try:
        yield _frames(thread, load, items)
    finally:
        thread.shutdown(cancel_futures=True)


def _frames(thread: ThreadPoolExecutor, load: Callable[[Item], Frame], items: Iterable[Item]) -> Iterator[Frame]:
    next_frame = None
    for item in items:
        # The current frame must be complete before the next one is started: it may end the loop with an exception.
        frame = next_frame.result() if next_frame else None
        next_frame = thread.submit(load, item)
        if frame is not None:
            yield frame
    if next_frame:
        yield next_frame.result()
