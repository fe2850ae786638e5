"""The division of frames: no frame both calibrates and judges."""

import pytest

from duospacenet.jobs.quantization_frames import Clip, shortened, split_frames
from duospacenet.jobs.sources import open_source
from duospacenet.runtime.errors import UsageError


def clips(*names: str, limit: int = 99) -> list[Clip]:
    """All frames of some sources."""
    sources = [open_source(name) for name in names]
    return [Clip(source, 0, min(limit, len(source)), name) for source, name in zip(sources, names, strict=True)]


def described(found: list[Clip]) -> list[tuple[str, int, int]]:
    return [(clip.source.identity, clip.start, clip.stop) for clip in found]


def test_named_sources_are_used_whole():
    calibration, judging = split_frames(clips("synthetic:1:6"), clips("synthetic:2:4", "synthetic:3:2"))
    assert described(calibration) == [("synthetic:1:6", 0, 6)]
    assert described(judging) == [("synthetic:2:4", 0, 4), ("synthetic:3:2", 0, 2)]


def test_the_second_half_of_several_sources_is_compared():
    calibration, judging = split_frames(clips("synthetic:1:6", "synthetic:2:4", "synthetic:3:2"), [])
    assert described(calibration) == [("synthetic:1:6", 0, 6)]
    assert described(judging) == [("synthetic:2:4", 0, 4), ("synthetic:3:2", 0, 2)]


@pytest.mark.parametrize(("frames", "middle"), [(2, 1), (5, 2), (6, 3)])
def test_a_single_source_is_divided_in_the_middle(frames, middle):
    calibration, judging = split_frames(clips(f"synthetic:1:{frames}"), [])
    assert described(calibration) == [(f"synthetic:1:{frames}", 0, middle)]
    assert described(judging) == [(f"synthetic:1:{frames}", middle, frames)]


def test_a_single_frame_cannot_be_divided():
    with pytest.raises(UsageError, match="--source: expected at least two frames"):
        split_frames(clips("synthetic:1:1"), [])


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
        split_frames(clips(*first), clips(*second))


def test_a_calibration_takes_the_first_frames_of_each_clip():
    calibration, _ = split_frames(clips("synthetic:1:6", "synthetic:2:2"), clips("synthetic:3:2"))
    assert [len(clip) for clip in shortened(calibration, 8)] == [4, 2]
    assert [len(clip) for clip in shortened(calibration, 1)] == [1, 1]
