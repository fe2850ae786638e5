"""Memory over a long drive, row P3, and the drive itself; `make soak` is the long one."""

import pytest
from soak import EVENTS, LARGEST_SLOPE_KB, soak

NUM_FRAMES = 1200


@pytest.fixture(scope="module")
def figures(pipeline):
    return soak(pipeline, NUM_FRAMES)


def test_p3_memory_does_not_grow_with_the_frames(figures):
    """The bound of 10,000 frames is `make soak`'s; over so few frames a page more or less weighs more."""
    assert figures.slope_kb <= 4 * LARGEST_SLOPE_KB


def test_p3_a_control_that_leaks_is_found(pipeline):
    assert soak(pipeline, NUM_FRAMES, leak_bytes=8 * 1024).slope_kb > 4 * LARGEST_SLOPE_KB


def test_s5_a_long_drive_of_four_streams_answers_as_fresh_streams_do(figures):
    assert figures.frames == NUM_FRAMES
    assert set(figures.events) == set(EVENTS)
    assert set(figures.resets) == {"new", "gap", "ego"}
    assert figures.compared > 10
    assert figures.mismatches == 0
