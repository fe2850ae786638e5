"""The protocol of a batch's processes: requests in on stdin, replies out on stdout, one JSON object per line.

A process ends when its stdin is closed, so it never outlives the process that started it.
"""

import json
import os
import queue
import signal
import sys
import threading
import time
from typing import Any

from ...runtime.errors import INTERRUPTED_EXIT_CODE
from ...runtime.termination import terminate_calls
from ..private_stdout import private_stdout

GRACE_S = 10.0  # for the work in progress, after stdin was closed


class Requester:
    """The other end of this process's stdin and stdout."""

    def __init__(self) -> None:
        """Call it in the main thread. When stdin is closed, the main thread gets a KeyboardInterrupt."""
        signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background ignores SIGINT
        self._replies = private_stdout()
        self._requests: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        threading.Thread(target=_read_stdin, args=(self._requests,), name="requests", daemon=True).start()

    def receive(self) -> Any:
        """Wait for the next request."""
        return json.loads(self._requests.get())

    def send(self, reply: dict[str, Any]) -> None:
        """Send a reply. Raises BrokenPipeError if the reader has ended."""
        self._replies.write(json.dumps(reply) + "\n")
        self._replies.flush()


def _read_stdin(requests: "queue.SimpleQueue[bytes]") -> None:
    signal.pthread_sigmask(signal.SIG_BLOCK, signal.valid_signals())  # signals are for the main thread
    for line in sys.stdin.buffer:
        requests.put(line)
    main_thread = threading.main_thread().ident
    assert main_thread is not None
    terminate_calls()
    signal.pthread_kill(main_thread, signal.SIGINT)
    time.sleep(GRACE_S)
    os._exit(INTERRUPTED_EXIT_CODE)  # the main thread is stuck, for example in a file system that does not answer
