"""Options of a benchmark that are text."""

import pytest

from duospacenet.jobs.benchmarking.bench_options import check_numbers, parse_percent, parse_streams
from duospacenet.runtime.errors import UsageError


@pytest.mark.parametrize("text, share", [("10%", 0.1), ("10", 0.1), ("2.5 %", 0.025), ("0", 0.0), ("250%", 2.5)])
def test_a_percentage_is_read_as_a_share(text, share):
    assert parse_percent(text) == pytest.approx(share)


@pytest.mark.parametrize("text", ["", "%", "ten", "-5%", "1e3", "nan", "10%%", "0x1"])
def test_other_text_is_not_a_percentage(text):
    with pytest.raises(UsageError, match="--max-regression: expected a percentage such as 10%; got "):
        parse_percent(text)


@pytest.mark.parametrize("text, numbers", [("1,2,4", (1, 2, 4)), ("3", (3,)), ("2, 2,1", (2, 1)), ("0", ())])
def test_numbers_of_streams(text, numbers):
    assert parse_streams(text) == numbers


@pytest.mark.parametrize("text", ["", "1,", "a", "1;2", "-1", "1.5", "²"])
def test_other_text_is_no_list_of_streams(text):
    with pytest.raises(UsageError, match="--streams: expected whole numbers"):
        parse_streams(text)


@pytest.mark.parametrize(
    "change, words",
    [
        ({"queries": 0}, "--queries: expected at least 1; got 0"),
        ({"rounds": -1}, "--rounds: expected at least 1"),
        ({"streams": (1, 0)}, "--streams: expected numbers from 1 to 64; got 0"),
        ({"streams": (65,)}, "got 65"),
        ({"threads": 0}, "threads: expected 1"),
        ({"max_regression": float("nan")}, "--max-regression"),
        ({"max_regression": -0.1}, "got -10 %"),
    ],
)
def test_numbers_outside_their_range_are_refused(change, words):
    numbers = {"queries": 1, "rounds": 1, "streams": (1,), "threads": 1, "max_regression": 0.1}
    check_numbers(**numbers)
    with pytest.raises(UsageError, match=words):
        check_numbers(**numbers | change)
