"""Tests of the clip loader: which clips a training run still needs, and loading them with and without workers."""

from dataclasses import replace
from itertools import chain

import pytest
import torch

from duospacenet.runtime.errors import InputError
from duospacenet.synthetic.drive import FIRST_TRAINING_SEED, SyntheticDrive
from duospacenet.training.clip_loader import load_clips, remaining_clips
from duospacenet.training.synthetic_clips import SyntheticClips
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.trainings import TINY, FixedClips, settings_with, synthetic_frames

GRID = TINY.voxels.size[:2]


# --- Remaining clips ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("step", "expected"), [(0, range(6)), (4, range(2, 6)), (8, range(4, 6)), (10, range(6, 6))])
def test_a_batch_of_equal_clips_takes_as_many_steps_as_a_clip_has_frames(step, expected):
    """Ten steps, two clips per batch, four frames per clip: three batches. The last one is used in part."""
    settings = settings_with(steps=10, batch_size=2, frames_per_clip=4)
    assert remaining_clips(SyntheticClips(0, 4, GRID), settings, step) == expected


def test_a_batch_takes_as_many_steps_as_its_longest_clip_has_frames():
    """Clips of 1 and 3 frames alternate. Each batch of two has 3 steps; batches of one have 1, 3, 1, 3, ... steps."""
    frames = synthetic_frames(1, 3)
    clips = FixedClips((frames[:1], frames))
    pairs = settings_with(steps=7, batch_size=2, frames_per_clip=3)
    assert remaining_clips(clips, pairs, 0) == range(6)
    assert remaining_clips(clips, pairs, 3) == range(2, 6)
    singles = settings_with(steps=7, batch_size=1, frames_per_clip=3)
    assert remaining_clips(clips, singles, 0) == range(4)
    assert remaining_clips(clips, singles, 4) == range(2, 4)


# --- Loading ------------------------------------------------------------------------------------------------------


def test_a_worker_gives_the_same_training_frames_in_the_same_order():
    clips = SyntheticClips(0, 2, GRID)
    alone, ahead = (
        list(load_clips(clips, TINY, preprocessing(TINY), range(3, 6), workers=workers)) for workers in (0, 1)
    )
    assert [len(clip) for clip in ahead] == [2, 2, 2]
    for one, other in zip(chain.from_iterable(alone), chain.from_iterable(ahead), strict=True):
        assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))
    drives = [SyntheticDrive(FIRST_TRAINING_SEED + number, 2) for number in range(3, 6)]
    times = [drive.frame_without_images(0).timestamp_s for drive in drives]
    assert [float(clip[0].timestamp_s) for clip in alone] == times


@pytest.mark.parametrize("workers", [0, 1])
def test_an_invalid_frame_raises_the_same_message_with_and_without_workers(workers):
    valid = synthetic_frames(1, 1)
    clips = FixedClips((valid, [replace(valid[0], timestamp_s=float("nan"), token="the invalid one")]))
    loaded = load_clips(clips, TINY, preprocessing(TINY), range(2), workers)
    assert len(next(loaded)) == 1
    with pytest.raises(InputError) as raised:
        next(loaded)
    assert str(raised.value).startswith("frame the invalid one: timestamp_s: expected ")
