"""Tests of the synthetic clips: which drive and which frames a clip number gives."""

from itertools import chain

import numpy as np
import pytest

from duospacenet.runtime.errors import InputError
from duospacenet.synthetic.drive import FIRST_TRAINING_SEED, SyntheticDrive
from duospacenet.training.samples.clips import MAX_CLIPS
from duospacenet.training.samples.past_frames import PastFrames
from duospacenet.training.samples.synthetic_clips import SyntheticClips, SyntheticWindows
from tests.helpers.trainings import TINY

GRID = TINY.voxels.size[:2]


def have_same_images(one, other):
    """Whether two frames have equal images and poses."""
    assert one.images.keys() == other.images.keys()
    return np.array_equal(one.global_T_ego, other.global_T_ego) and all(
        np.array_equal(image, other.images[name]) for name, image in one.images.items()
    )


def test_no_training_seed_can_be_written_as_a_synthetic_source():
    lowest = SyntheticClips(0, 1, GRID).frames(0)[0].scene.removeprefix("synthetic-")
    assert int(lowest) == FIRST_TRAINING_SEED == 10**18
    assert len(lowest) == 19
    assert SyntheticDrive.parse("synthetic:" + "9" * 18).seed < FIRST_TRAINING_SEED
    with pytest.raises(InputError, match="expected synthetic:SEED"):
        SyntheticDrive.parse(f"synthetic:{lowest}")


def test_a_number_always_gives_the_same_frames_and_another_number_gives_others():
    first, again, other = (SyntheticClips(3, 2, GRID).frames(number) for number in (5, 5, 6))
    assert len(first) == SyntheticClips(3, 2, GRID).num_steps(5) == 2
    assert all(have_same_images(one, two) for one, two in zip(first, again, strict=True))
    assert not have_same_images(first[0], other[0])
    assert first[0].ground_truth.maps["drivable_area"].shape == GRID


@pytest.mark.parametrize("length", [1, 2])
def test_anchors_come_from_a_fixed_number_of_frames_for_any_clip_length(length, monkeypatch):
    monkeypatch.setattr("duospacenet.training.samples.synthetic_clips.ANCHOR_FRAMES", 3)
    clips = SyntheticClips(3, length, GRID)
    frames = list(chain.from_iterable(map(clips.frames, range(3))))[:3]
    for ground_truth, frame in zip(clips.ground_truth(), frames, strict=True):
        np.testing.assert_array_equal(ground_truth.boxes, frame.ground_truth.boxes)


def test_the_clips_of_two_seeds_never_overlap():
    """The last clip of one seed comes right before the first clip of the next seed. The largest seed works as well."""
    last, first = SyntheticClips(0, 1, GRID).frames(MAX_CLIPS - 1), SyntheticClips(1, 1, GRID).frames(0)
    numbers = [int(frame.scene.removeprefix("synthetic-")) for (frame,) in (last, first)]
    assert numbers[1] == numbers[0] + 1
    assert len(SyntheticClips(999, 1, GRID).frames(0)) == 1


def test_the_identity_of_synthetic_clips_depends_on_the_seed_and_the_length():
    identities = {SyntheticClips(seed, frames, GRID).identity for seed in (0, 1) for frames in (1, 2)}
    assert len(identities) == 4


# --- Windows ------------------------------------------------------------------------------------------------------


def windows(past=2, strides=(1,), seed=3):
    return SyntheticWindows(SyntheticClips(seed, 4, GRID), PastFrames(seed, past, strides))


@pytest.fixture
def rendered(monkeypatch):
    """Frames are not rendered; the list gets the numbers of those that would be."""
    numbers = []
    monkeypatch.setattr(
        SyntheticDrive, "frame", lambda drive, index: numbers.append(index) or drive.frame_without_images(index)
    )
    return numbers


def frame_numbers(clips, number):
    """The numbers of a sample's frames in its drive."""
    return [int(frame.token.rpartition("-")[2]) for frame in clips.frames(number)]


def test_a_window_is_a_frame_of_its_own_drive_with_the_frames_before_it(rendered):
    """With drives of 4 frames and 2 past frames, samples end at any of the frames and have 1 to 3 frames."""
    samples = [frame_numbers(windows(), number) for number in range(24)]
    assert {tuple(sample) for sample in samples} == {(0,), (0, 1), (0, 1, 2), (1, 2, 3)}
    assert [windows().num_steps(number) for number in range(3)] == [1, 1, 1]
    assert {frame.scene for frame in windows().frames(5)} == {SyntheticClips(3, 4, GRID).frames(5)[0].scene}
    assert samples != [frame_numbers(windows(seed=4), number) for number in range(24)]


def test_a_window_has_frames_at_the_stride_of_its_sample_and_no_other_frame_is_rendered(rendered):
    clips = windows(strides=(2,))
    samples = [frame_numbers(clips, number) for number in range(24)]
    assert {tuple(sample) for sample in samples} == {(0,), (1,), (0, 2), (1, 3)}
    assert rendered == list(chain.from_iterable(samples))


def test_windows_have_another_identity_than_clips_of_the_same_drives():
    assert windows().identity != SyntheticClips(3, 4, GRID).identity
