"""Tests of the texts of progress."""

import pytest

from duospacenet.runtime.progress import describe_duration


@pytest.mark.parametrize(
    ("seconds", "text"), [(0, "0 s"), (59, "59 s"), (61, "1 min"), (3599, "1 h 0 min"), (9000, "2 h 30 min")]
)
def test_durations_have_the_unit_that_fits(seconds, text):
    assert describe_duration(seconds) == text
