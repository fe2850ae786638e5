"""Which past frames are in the window: schedules worked out by hand, and two properties over random schedules."""

import numpy as np
import pytest

from duospacenet.runtime.errors import UsageError
from duospacenet.runtime.window_selection import WindowSelection

AT_2_HZ = WindowSelection(num_past=3, step_s=0.5, largest_gap_s=2.0)
NEWEST = WindowSelection(num_past=3)


def selected_ages(selection, ages_s):
    return [ages_s[index] for index in selection.select(ages_s)]


def ages(interval_s, number):
    """The ages of so many past frames of a regular stream, newest first. Rounded, as a person writes them."""
    return [round(interval_s * (index + 1), 4) for index in range(number)]


# --- Schedules worked out by hand ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("num_past_frames", "expected"),
    [
        (0, []),
        (1, []),  # 0.1 s is less than half a step
        (2, []),
        (3, [0.3]),  # the oldest frame is the nearest to 0.5 s
        (4, [0.4]),
        (5, [0.5]),
        (7, [0.5]),  # the second past frame must be at least 0.75 s old
        (8, [0.5, 0.8]),
        (10, [0.5, 1.0]),
        (12, [0.5, 1.0]),
        (13, [0.5, 1.0, 1.3]),
        (15, [0.5, 1.0, 1.5]),
        (40, [0.5, 1.0, 1.5]),
    ],
)
def test_a_stream_at_10_hz_fills_the_window_with_frames_half_a_second_apart(num_past_frames, expected):
    assert selected_ages(AT_2_HZ, ages(0.1, num_past_frames)) == expected


def test_a_stream_at_12_hz_takes_every_sixth_frame():
    assert AT_2_HZ.select([(index + 1) / 12 for index in range(30)]) == [5, 11, 17]


def test_a_stream_at_7_hz_takes_the_nearest_frames_without_drifting():
    """The frames are at multiples of 0.1429 s: 0.4286 and 0.5714 are equally near to 0.5, and the newer one is taken.

    7 · 0.1429 s is exactly 1 s. 10 · 0.1429 = 1.4286 and 11 · 0.1429 = 1.5714 are equally near to 1.5.
    """
    assert AT_2_HZ.select([(index + 1) / 7 for index in range(30)]) == [2, 6, 9]


def test_of_two_equally_near_frames_the_newer_one_is_taken_whatever_the_rounding():
    """At 5 Hz, 0.4 and 0.6 s are equally near to 0.5 s. Time stamps near 1.5e9 s are rounded to 0.24 microseconds."""
    for start_s in np.random.default_rng(0).uniform(1.5e9, 1.6e9, 50):
        times_s = start_s + 0.2 * np.arange(20)
        assert AT_2_HZ.select(list(times_s[-1] - times_s[-2::-1])) == [1, 4, 6]


def test_dropped_frames_and_jitter_at_10_hz():
    """The frames at 0.5 s and at 0.9 to 1.2 s are missing."""
    jittered = [0.11, 0.19, 0.32, 0.41, 0.58, 0.69, 0.81, 1.28, 1.42, 1.51, 1.57, 1.72]
    # Slot 1: |0.58 - 0.5| = 0.08 is less than |0.41 - 0.5| = 0.09. Slot 2, from 0.83 s on: 1.28 is the nearest to 1.0.
    # Slot 3, from 1.53 s on: 1.57 is the nearest to 1.5.
    assert selected_ages(AT_2_HZ, jittered) == [0.58, 1.28, 1.57]


def test_after_a_pause_the_frames_are_half_a_step_apart_at_least():
    """No frame is younger than 1.2 s. The nominal ages are passed, so each slot takes the newest frame it may take."""
    assert selected_ages(AT_2_HZ, [1.2 + 0.1 * index for index in range(20)]) == pytest.approx([1.2, 1.5, 1.8])


def test_a_frame_is_not_taken_if_it_is_older_than_the_largest_gap():
    assert selected_ages(AT_2_HZ, [0.1, 2.05, 2.5]) == []
    assert selected_ages(AT_2_HZ, [0.1, 2.0, 4.01]) == [2.0]


def test_without_a_step_the_newest_frames_are_taken_whatever_their_ages():
    assert selected_ages(NEWEST, [0.001, 0.002, 1.9, 3.0]) == [0.001, 0.002, 1.9]
    assert NEWEST.select([0.5]) == [0]
    assert WindowSelection(num_past=0).select([0.5]) == []
    assert WindowSelection(num_past=0, step_s=0.5, largest_gap_s=2.0).select([0.5]) == []


@pytest.mark.parametrize("step_s", [0.0, -0.5, 0.009, 2.01, float("nan"), float("inf")])
def test_a_step_that_no_frames_can_have_is_refused(step_s):
    with pytest.raises(UsageError, match=r"history step: expected 0\.01 to 2 s"):
        WindowSelection(num_past=3, step_s=step_s, largest_gap_s=2.0)


# --- Memory -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("rate_hz", "kept"), [(2, 4), (10, 16), (12, 19)])
def test_the_frames_of_one_and_a_half_seconds_are_kept(rate_hz, kept):
    """Every frame of a stream at 10 Hz is in a window 0.5, 1.0 and 1.5 s later."""
    assert AT_2_HZ.num_needed([index / rate_hz for index in range(100)]) == kept


def test_the_newest_frame_is_always_kept():
    assert AT_2_HZ.num_needed([0.0]) == 1
    assert WindowSelection(num_past=0, step_s=0.5, largest_gap_s=2.0).num_needed([0.0, 0.5]) == 1
    assert WindowSelection(num_past=0).num_needed([0.0, 0.5]) == 1
    assert NEWEST.num_needed([0.0, 0.1, 0.2, 0.3]) == 3


def random_times(rng):
    """The times of a stream with a random rate, jitter, dropped frames and pauses below the largest gap."""
    interval_s = rng.choice([0.02, 0.04, 0.08, 0.1, 0.15, 0.25, 0.5, 0.7])
    steps_s = interval_s * (1 + rng.uniform(-0.4, 0.4, 120)) * rng.choice([1, 1, 1, 1, 2, 4], 120)
    steps_s[rng.random(120) < 0.05] = rng.uniform(0.5, 2.0)
    return 100 + np.cumsum(np.minimum(steps_s, 2.0))


@pytest.mark.parametrize("seed", range(60))
def test_forgetting_frames_never_changes_a_later_window(seed):
    """The windows over the kept frames equal those over all frames so far."""
    rng = np.random.default_rng(seed)
    selection = WindowSelection(int(rng.integers(1, 6)), rng.choice([0.3, 0.5, 1.0]), 2.0)
    kept, past = [], []
    for now in random_times(rng):
        windows = [[times[i] for i in selection.select([now - time for time in times])] for times in (kept, past)]
        assert windows[0] == windows[1]
        past.insert(0, now)
        kept.insert(0, now)
        kept = kept[: selection.num_needed([now - time for time in kept])]
    assert len(kept) < len(past)


@pytest.mark.parametrize("seed", range(30))
def test_a_stream_as_fast_as_the_step_gets_its_newest_frames(seed):
    """2 Hz with jitter of 50 ms, dropped frames, and pauses of up to 2 s."""
    rng = np.random.default_rng(seed)
    times = 0.5 * np.flatnonzero(rng.random(80) < 0.7)
    times = (times + rng.uniform(-0.05, 0.05, len(times)))[::-1]
    for index in range(len(times)):
        past = list(times[index] - times[index + 1 :])
        steps = np.diff([0.0, *past[:3]])
        num_reachable = int((np.cumsum(steps > 2.0) == 0).sum())  # beyond a pause, the stream itself resets
        assert AT_2_HZ.select(past) == list(range(num_reachable))
