"""The division of frames: no frame both calibrates and judges."""

import pytest

from duospacenet.jobs.quantization_frames import Clip, shortened, split_frames
from duospacenet.jobs.sources import open_source
from duospacenet.runtime.errors import UsageError


def sources(*names: str):
    return [open_source(name) for name in names]


def described(clips: list[Clip]) -> list[tuple[str, int, int]]:
    return [(clip.source.identity, clip.start, clip.stop) for clip in clips]


def test_named_sources_are_used_whole():
    calibration, judging = split_frames(sources("synthetic:1:6"), sources("synthetic:2:4", "synthetic:3:2"))
    assert described(calibration) == [("synthetic:1:6", 0, 6)]
    assert described(judging) == [("synthetic:2:4", 0, 4), ("synthetic:3:2", 0, 2)]


def test_the_second_half_of_several_sources_is_compared():
    calibration, judging = split_frames(sources("synthetic:1:6", "synthetic:2:4", "synthetic:3:2"), [])
    assert described(calibration) == [("synthetic:1:6", 0, 6)]
    assert described(judging) == [("synthetic:2:4", 0, 4), ("synthetic:3:2", 0, 2)]


@pytest.mark.parametrize(("frames", "middle"), [(2, 1), (5, 2), (6, 3)])
def test_a_single_source_is_divided_in_the_middle(frames, middle):
    calibration, judging = split_frames(sources(f"synthetic:1:{frames}"), [])
    assert described(calibration) == [(f"synthetic:1:{frames}", 0, middle)]
    assert described(judging) == [(f"synthetic:1:{frames}", middle, frames)]


def test_a_single_frame_cannot_be_divided():
    with pytest.raises(UsageError, match="--source: expected at least two frames"):
        split_frames(sources("synthetic:1:1"), [])


def test_the_limit_holds_for_each_source():
    calibration, judging = split_frames(sources("synthetic:1:6"), sources("synthetic:2:4"), limit=3)
    assert [len(clip) for clip in (*calibration, *judging)] == [3, 3]
    assert described(split_frames(sources("synthetic:1:6"), [], limit=4)[1]) == [("synthetic:1:6", 2, 4)]


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (["synthetic:1:6"], ["synthetic:1:6"]),
        (["synthetic:1:6", "synthetic:2:6"], ["synthetic:3:6", "synthetic:2:6"]),
        (["synthetic:1:6", "synthetic:1:6"], []),
    ],
)
def test_the_same_source_twice_is_refused(first, second):
    with pytest.raises(UsageError, match=r"--eval-source: expected other sources .*; got synthetic:\d:6 twice"):
        split_frames(sources(*first), sources(*second))


def test_a_calibration_takes_the_first_frames_of_each_clip():
    clips, _ = split_frames(sources("synthetic:1:6", "synthetic:2:2"), sources("synthetic:3:2"))
    assert [len(clip) for clip in shortened(clips, 8)] == [4, 2]
    assert [len(clip) for clip in shortened(clips, 1)] == [1, 1]
