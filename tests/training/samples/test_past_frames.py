"""Tests of the past frames: which frames a window has, and its stride."""

import pytest

from duospacenet.training.samples.past_frames import PastFrames


@pytest.mark.parametrize(
    ("stride", "newest", "first", "expected"),
    [
        (1, 9, 0, [6, 7, 8, 9]),
        (2, 9, 0, [3, 5, 7, 9]),
        (2, 9, 5, [5, 7, 9]),
        (2, 9, 6, [7, 9]),
        (1, 9, 9, [9]),
        (2, 3, 0, [1, 3]),
    ],
)
def test_a_window_has_up_to_three_past_frames_at_its_stride_from_the_same_scene(stride, newest, first, expected):
    assert PastFrames(0, 3, (stride,)).window(newest, first, sample=0) == expected


def test_a_window_without_past_frames_is_a_single_frame():
    assert PastFrames(0, 0, (1, 2)).window(9, 0, sample=0) == [9]


def test_each_sample_has_one_of_the_strides_which_depends_on_the_seed_and_its_number_only():
    """1,000 samples: each of two strides has 500 ± 5 standard deviations (16)."""
    past = PastFrames(7, 3, (1, 2))
    strides = [past.stride(sample) for sample in range(1000)]
    assert set(strides) == {1, 2}
    assert 420 < strides.count(2) < 580
    assert strides == [PastFrames(7, 1, (1, 2)).stride(sample) for sample in range(1000)]
    assert strides != [PastFrames(8, 3, (1, 2)).stride(sample) for sample in range(1000)]
    assert past.window(9, 0, sample=strides.index(2)) == [3, 5, 7, 9]
    assert past.window(9, 0, sample=strides.index(1)) == [6, 7, 8, 9]
