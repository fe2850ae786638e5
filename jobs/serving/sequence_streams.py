"""The streams of the sequences in progress. There are never more than the server has places, so memory is bounded."""

import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

from ...runtime import Stream
from ...runtime.errors import InputError

SequenceId = int | str
IDLE_PERIODS = 2  # Triton's idle time starts when a request arrives, and the request may then wait for its turn


class OpenSequence(NamedTuple):
    """A sequence in progress. last_s: when its last request was finished, by the clock of `SequenceStreams`."""

    stream: Stream
    last_s: float


class SequenceStreams:
    """One stream per sequence. A sequence begins with a start, and ends with an end or when it is lost.

    Triton does not report that a sequence was lost. Its stream is freed when its place is needed, or with the first
    request of another sequence after `IDLE_PERIODS` idle times.
    """

    def __init__(
        self,
        open_stream: Callable[[], Stream],
        max_sequences: int,
        idle_s: float,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """open_stream: opens a stream with an empty history. idle_s: the server's idle time [s]."""
        self._open_stream = open_stream
        self._max_sequences = max_sequences
        self._longest_s = IDLE_PERIODS * idle_s
        self._clock = clock
        self._open: OrderedDict[SequenceId, OpenSequence] = OrderedDict()  # the one that was used last is at the end

    def __len__(self) -> int:
        """The number of streams in memory."""
        return len(self._open)

    @contextmanager
    def stream_of(self, sequence: SequenceId, starts: bool, ends: bool) -> Iterator[Stream]:
        """Give the stream of a request's sequence. An end frees it, also if the request fails.

        starts: the request begins the sequence with an empty history, even if it was in progress.
        Raises InputError for a sequence that has not started or was lost.
        """
        stream = self._start(sequence) if starts else self._continue(sequence)
        try:
            yield stream
        finally:
            del self._open[sequence]
            if not ends:
                self._open[sequence] = OpenSequence(stream, self._clock())
            self._free_lost()

    def _start(self, sequence: SequenceId) -> Stream:
        """Open a stream, after making room for it: the server has given a place of a lost sequence to this one."""
        self._open.pop(sequence, None)
        while len(self._open) >= self._max_sequences:
            self._open.popitem(last=False)
        stream = self._open_stream()
        self._open[sequence] = OpenSequence(stream, self._clock())
        return stream

    def _continue(self, sequence: SequenceId) -> Stream:
        if sequence not in self._open:
            raise InputError(
                f"sequence {sequence!r}: expected a sequence in progress; it has not started, or it was lost. "
                "Send the frame again with the start flag."
            )
        return self._open[sequence].stream

    def _free_lost(self) -> None:
        """Free the streams that were idle for too long."""
        now_s = self._clock()
        while self._open and now_s - next(iter(self._open.values())).last_s > self._longest_s:
            self._open.popitem(last=False)
