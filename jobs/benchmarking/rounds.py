"""The rounds of a benchmark: in each, every target runs for a short time, so that all of them meet the same machine."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from .bench_report import ColdStartRecord, RatioRecord
from .samples import Samples


class Worker(Protocol):
    """A loaded target; `call` as in `WorkerProcess`."""

    def call(self, method: str, **arguments: Any) -> Any: ...


@dataclass
class Turn:
    """The part of one target in every round, and its results.

    frames: number of frames per round.
    measures_cold_start: also measure the first frame of a stream in every round.
    samples: of frames with a full window.
    first_frames_s: of the first frames, one per round [s].
    """

    worker: Worker
    frames: int
    measures_cold_start: bool = False
    samples: Samples = field(default_factory=Samples)
    first_frames_s: list[float] = field(default_factory=list)


def run_round(turns: Sequence[Turn], number: int) -> None:
    """Run round `number`, counted from 0, and add its samples to the turns. A round that fails adds nothing."""
    measured = [(turn, *_take_turn(turn)) for turn in order_of_round(turns, number)]
    for turn, rows, first_frames_s in measured:
        turn.first_frames_s += first_frames_s
        turn.samples.add_round(rows)


def order_of_round(turns: Sequence[Turn], number: int) -> list[Turn]:
    """The turns in the order of round `number`.

    The order rotates by one per round, so that no target always runs first.
    """
    start = number % len(turns)
    return [*turns[start:], *turns[:start]]


def _take_turn(turn: Turn) -> tuple[list[dict[str, float]], list[float]]:
    rows = turn.worker.call("measure", count=turn.frames)
    return rows, [turn.worker.call("measure_first_frame")] if turn.measures_cold_start else []


def ratio_of_rounds(alternative: Sequence[float], bundle: Sequence[float]) -> RatioRecord:
    """How many times longer a frame of the alternative takes, from the median frames of the same rounds.

    After an interruption, one of them may have a round more, which is left out.
    """
    count = min(len(alternative), len(bundle))
    ratios = np.divide(alternative[:count], bundle[:count])
    q1, median, q3 = (round(float(value), 4) for value in np.percentile(ratios, [25, 50, 75]))
    return RatioRecord(median=median, q1=q1, q3=q3)


def cold_start(bundle: Turn, window: int) -> ColdStartRecord:
    """The first frame of a stream beside the full window, from the same rounds."""
    full_s = bundle.samples.round_medians_s
    first_s = bundle.first_frames_s[: len(full_s)]  # one more after an interruption
    return ColdStartRecord(
        window=window,
        first_frame_ms=round(1000 * float(np.median(first_s)), 4),
        full_window_ms=round(1000 * float(np.median(full_s)), 4),
        ratio=round(float(np.median(np.divide(full_s, first_s))), 4),
    )
