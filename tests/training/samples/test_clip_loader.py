"""Tests of the clip loader: which clips a training run still needs, and loading them with and without workers."""

import os
import resource
import signal
from dataclasses import replace
from itertools import chain
from multiprocessing import resource_tracker

import pytest
import torch

from duospacenet.runtime.errors import InputError
from duospacenet.runtime.process_errors import LostProcessError
from duospacenet.synthetic.drive import FIRST_TRAINING_SEED, SyntheticDrive
from duospacenet.training.samples.clip_loader import (
    clips_of_process,
    load_clips,
    lost_workers_reported,
    remaining_clips,
)
from duospacenet.training.samples.past_frames import PastFrames
from duospacenet.training.samples.synthetic_clips import SyntheticClips, SyntheticWindows
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.process_tree import child_processes
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


@pytest.mark.parametrize(("step", "first"), [(7, 2), (13, 3), (21, 5), (27, 6)])
def test_an_extended_training_goes_on_with_a_new_batch_within_the_last_one(step, first):
    """Batches take six steps. The training ended after step 7, then after step 21, and has 30 steps now.

    Batch 0 took steps 1 to 6, batch 1 step 7, batch 2 steps 8 to 13, batch 3 steps 14 to 19, batch 4 steps 20 and 21,
    batch 5 takes steps 22 to 27, and batch 6 steps 28 to 30.
    """
    remaining = remaining_clips(SyntheticClips(0, 6, GRID), settings_with(steps=30), step, [7, 21])
    assert remaining == range(first, 7)


def test_a_batch_of_windows_takes_one_step():
    """Drives of four frames; of each, one sample is trained."""
    clips = SyntheticWindows(SyntheticClips(0, 4, GRID), PastFrames(0, 3))
    settings = settings_with(steps=5, batch_size=2, frames_per_clip=4, history="windows")
    assert remaining_clips(clips, settings, 0) == range(10)
    assert remaining_clips(clips, settings, 3) == range(6, 10)


def test_each_process_has_an_equal_and_contiguous_part_of_every_batch():
    settings = settings_with(batch_size=4)
    numbers = range(8, 20)
    assert list(clips_of_process(numbers, settings, 0, 1)) == list(numbers)
    assert list(clips_of_process(numbers, settings, 0, 2)) == [8, 9, 12, 13, 16, 17]
    assert list(clips_of_process(numbers, settings, 1, 2)) == [10, 11, 14, 15, 18, 19]
    assert [list(clips_of_process(numbers, settings, rank, 4)) for rank in (0, 3)] == [[8, 12, 16], [11, 15, 19]]


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


def test_past_frames_of_a_window_have_no_ground_truth():
    """Only the newest frame is trained. Here it has boxes and masks."""

    class Windows(FixedClips):
        def num_steps(self, number):
            return 1

    (clip,) = load_clips(Windows((synthetic_frames(1, 3),)), TINY, preprocessing(TINY), range(1), workers=0)
    assert [bool(frame.boxes_known) for frame in clip] == [False, False, True]
    assert [frame.map_known.tolist() for frame in clip] == [[False, False], [False, False], [True, True]]
    assert [len(frame.boxes) > 0 for frame in clip] == [False, False, True]


@pytest.mark.parametrize(
    ("tasks", "boxes_known", "maps_known"), [("both", True, True), ("detection", True, False), ("maps", False, True)]
)
def test_frames_have_the_ground_truth_of_the_trained_tasks(tasks, boxes_known, maps_known):
    settings = settings_with(tasks=tasks)
    clips = FixedClips((synthetic_frames(1, 1),))
    ((frame,),) = load_clips(clips, TINY, preprocessing(TINY), range(1), workers=0, settings=settings)
    assert bool(frame.boxes_known) == (len(frame.boxes) > 0) == boxes_known
    assert frame.map_known.tolist() == [maps_known, maps_known]
    assert bool(frame.maps.any()) == maps_known


def test_a_killed_worker_is_reported_with_the_remedy():
    """Loading with workers also raises the limit of open files, because each tensor is sent as one."""
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(before[0], before[1] - 1), before[1]))
    resource_tracker.ensure_running()  # also a child process
    earlier = set(child_processes(os.getpid()))
    loaded = load_clips(FixedClips((synthetic_frames(1, 1),)), TINY, preprocessing(TINY), range(50), workers=1)
    next(loaded)
    assert resource.getrlimit(resource.RLIMIT_NOFILE) == (before[1], before[1])
    for process in set(child_processes(os.getpid())) - earlier:
        os.kill(process, signal.SIGKILL)
    with pytest.raises(LostProcessError, match=r"^--workers: expected the next clip from a worker process; got none"):
        list(loaded)


def test_a_killed_worker_is_reported_wherever_it_is_noticed_and_other_errors_are_not_changed():
    with pytest.raises(LostProcessError), lost_workers_reported():
        raise RuntimeError("DataLoader worker (pid 17) is killed by signal: Killed. ")
    with pytest.raises(LostProcessError), lost_workers_reported(receiving=True):
        raise ConnectionResetError(104, "Connection reset by peer")
    for other in (
        RuntimeError("CUDA out of memory"),
        RuntimeError("Caught RuntimeError in DataLoader worker process 0."),
    ):
        with pytest.raises(RuntimeError) as raised, lost_workers_reported(receiving=True):
            raise other
        assert raised.value is other
    for other in (FileNotFoundError("Caught FileNotFoundError in DataLoader worker process 0."), OSError("disk full")):
        with pytest.raises(OSError) as failed, lost_workers_reported(receiving=True):
            raise other
        assert failed.value is other
    with pytest.raises(ConnectionResetError), lost_workers_reported():
        raise ConnectionResetError(104, "Connection reset by peer")
