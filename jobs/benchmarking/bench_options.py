"""The options of a benchmark that are text, and the limits of its numbers."""

import math
import re
from collections.abc import Sequence

from ...runtime.cores import check_thread_count
from ...runtime.errors import UsageError

MAX_STREAMS = 64


def parse_streams(text: str) -> tuple[int, ...]:
    """Read a list of numbers such as "1,2,4". "0" is the empty list. Raises UsageError."""
    words = [word.strip() for word in text.split(",")]
    if words == ["0"]:
        return ()
    if not all(re.fullmatch("[0-9]{1,6}", word) for word in words):
        raise UsageError(f"--streams: expected whole numbers, separated by commas, such as 1,2,4; got {text!r}.")
    return tuple(dict.fromkeys(int(word) for word in words))


def parse_percent(text: str) -> float:
    """Read a percentage such as "10%" or "10" as a share, 0.1. Raises UsageError."""
    number = re.fullmatch(r"([0-9]{1,4}(\.[0-9]{1,6})?) ?%?", text.strip())
    if number is None:
        raise UsageError(f"--max-regression: expected a percentage such as 10%; got {text!r}.")
    return float(number[1]) / 100


def check_numbers(queries: int, rounds: int, streams: Sequence[int], threads: int, max_regression: float) -> None:
    """Raise UsageError for a number outside its range."""
    check_thread_count(threads)
    for name, number in {"queries": queries, "rounds": rounds}.items():
        if number < 1:
            raise UsageError(f"--{name}: expected at least 1; got {number}.")
    for count in streams:
        if not 1 <= count <= MAX_STREAMS:
            raise UsageError(f"--streams: expected numbers from 1 to {MAX_STREAMS}; got {count}.")
    if not 0 <= max_regression < math.inf:
        raise UsageError(f"--max-regression: expected at least 0 %; got {100 * max_regression:g} %.")
