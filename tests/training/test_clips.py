"""What is trained on: which frames a number stands for, and what reaches the training of them."""

from dataclasses import replace
from itertools import chain

import numpy as np
import pytest
import torch

from duospacenet.runtime.errors import InputError
from duospacenet.runtime.frame import GroundTruth
from duospacenet.runtime.geometry import rotation_z
from duospacenet.synthetic.drive import FIRST_TRAINING_SEED, SyntheticDrive
from duospacenet.training.clips import MAX_CLIPS, SourceClips, SyntheticClips, load_clips, remaining_clips
from duospacenet.weights.input_contract import preprocessing, temporal_window
from tests.helpers.trainings import TINY, FixedClips, FixedSource, settings_with, synthetic_frames

GRID = TINY.voxels.size[:2]
LIMITS = temporal_window(TINY)  # 2 s, 70 m/s


def source_of(*scene_lengths):
    """Frames half a second apart, of scenes with these numbers of frames; each has its index for a token."""
    (frame,) = synthetic_frames(1, 1)
    names = [f"scene {number}" for number, length in enumerate(scene_lengths) for _ in range(length)]
    return FixedSource(
        [replace(frame, scene=name, token=str(i), timestamp_s=100 + 0.5 * i) for i, name in enumerate(names)]
    )


def same_frame(one, other):
    """Whether two frames show the same from the same place."""
    assert one.images.keys() == other.images.keys()
    return np.array_equal(one.global_T_ego, other.global_T_ego) and all(
        np.array_equal(image, other.images[name]) for name, image in one.images.items()
    )


def tokens(drives, number):
    return [int(frame.token) for frame in drives.frames(number)]


# --- Drawn drives -------------------------------------------------------------------------------------------------


def test_no_seed_of_a_training_can_be_written_as_a_synthetic_source():
    lowest = SyntheticClips(0, 1, GRID).frames(0)[0].scene.removeprefix("synthetic-")
    assert int(lowest) == FIRST_TRAINING_SEED == 10**18
    assert len(lowest) == 19
    assert SyntheticDrive.parse("synthetic:" + "9" * 18).seed < FIRST_TRAINING_SEED
    with pytest.raises(InputError, match="expected synthetic:SEED"):
        SyntheticDrive.parse(f"synthetic:{lowest}")


def test_the_same_number_gives_the_same_frames_and_another_one_others():
    first, again, other = (SyntheticClips(3, 2, GRID).frames(number) for number in (5, 5, 6))
    assert len(first) == SyntheticClips(3, 2, GRID).length(5) == 2
    assert all(same_frame(one, two) for one, two in zip(first, again, strict=True))
    assert not same_frame(first[0], other[0])
    assert first[0].ground_truth.maps["drivable_area"].shape == GRID


@pytest.mark.parametrize("length", [1, 2])
def test_anchors_are_sought_in_as_many_frames_however_short_the_drives_are(length, monkeypatch):
    monkeypatch.setattr("duospacenet.training.clips.ANCHOR_FRAMES", 3)
    drives = SyntheticClips(3, length, GRID)
    frames = list(chain.from_iterable(map(drives.frames, range(3))))[:3]
    for centres, frame in zip(drives.ground_truth_centres(), frames, strict=True):
        np.testing.assert_array_equal(centres, frame.ground_truth.boxes[:, :3])


def test_the_drives_of_two_seeds_never_meet():
    """The last number of one seed lies before the first of the next; the largest seed still draws."""
    last, first = SyntheticClips(0, 1, GRID).frames(MAX_CLIPS - 1), SyntheticClips(1, 1, GRID).frames(0)
    numbers = [int(frame.scene.removeprefix("synthetic-")) for (frame,) in (last, first)]
    assert numbers[1] == numbers[0] + 1
    assert len(SyntheticClips(999, 1, GRID).frames(0)) == 1


def test_drawn_drives_are_told_apart_by_their_words():
    words = {SyntheticClips(seed, frames, GRID).identity for seed in (0, 1) for frames in (1, 2)}
    assert len(words) == 4


# --- Cut drives ---------------------------------------------------------------------------------------------------


def test_a_source_is_cut_where_a_scene_ends_and_after_so_many_frames():
    drives = SourceClips(source_of(5, 2, 4), 0, 2, LIMITS)
    pieces = sorted(tokens(drives, number) for number in range(6))
    assert pieces == [[0, 1], [2, 3], [4], [5, 6], [7, 8], [9, 10]]
    assert [drives.length(number) for number in range(6)] == [len(tokens(drives, number)) for number in range(6)]


def changed(source, index, **changes):
    """The source with another frame `index`."""
    frames = list(source)
    frames[index] = replace(frames[index], **changes)
    return FixedSource(frames)


def test_a_source_is_cut_where_a_stream_would_forget():
    """Frames 3 and 4 of one scene come 2.1 s too late; then frame 2 is a hundred metres from those around it."""
    late = FixedSource([replace(f, timestamp_s=f.timestamp_s + 2.1 * (i > 2)) for i, f in enumerate(source_of(5))])
    assert sorted(tokens(SourceClips(late, 0, 9, LIMITS), number) for number in range(2)) == [[0, 1, 2], [3, 4]]
    away = np.array(next(iter(source_of(1))).global_T_ego)
    away[0, 3] += 100
    jumps = changed(source_of(5), 2, global_T_ego=away)
    assert sorted(tokens(SourceClips(jumps, 0, 9, LIMITS), number) for number in range(3)) == [[0, 1], [2], [3, 4]]


def test_a_source_is_cut_where_the_ego_turns_on_the_spot():
    turned = np.array(next(iter(source_of(1))).global_T_ego)
    turned[:3, :3] = turned[:3, :3] @ rotation_z(np.pi)
    frames = [replace(f, global_T_ego=turned) if i > 1 else f for i, f in enumerate(source_of(4))]
    assert LIMITS.largest_turn_rad_s * 0.5 < np.pi
    assert sorted(tokens(SourceClips(FixedSource(frames), 0, 9, LIMITS), number) for number in range(2)) == [
        [0, 1],
        [2, 3],
    ]


def test_no_picture_is_read_to_know_where_a_source_is_cut_or_what_stands_where():
    class Unread(FixedSource):
        def frame(self, index):
            raise AssertionError(f"frame {index} was read")

    moved = [replace(frame, ground_truth=with_one_box(index)) for index, frame in enumerate(source_of(3, 2))]
    drives = SourceClips(Unread(moved), 0, 2, LIMITS)
    assert sorted(drives.length(number) for number in range(3)) == [1, 2, 2]
    assert [centres.tolist() for centres in drives.ground_truth_centres()] == [
        [[float(index), 0, 0]] for index in range(5)
    ]


def with_one_box(x_m):
    return GroundTruth(np.array([[x_m, 0, 0, 1, 1, 1, 0, 0, 0.0]]), ("car",))


def test_other_limits_or_another_source_make_other_drives_by_their_words():
    sources = (source_of(3), replace(source_of(3), identity="others"))
    longer = LIMITS.model_copy(update={"largest_time_delta_s": 3.0})
    slower = LIMITS.model_copy(update={"largest_speed_m_s": 30.0})
    stiffer = LIMITS.model_copy(update={"largest_turn_rad_s": 1.0})
    all_limits = (LIMITS, longer, slower, stiffer)
    assert len({SourceClips(source, 0, 2, limits).identity for source in sources for limits in all_limits}) == 8


def test_every_epoch_has_every_frame_once_in_another_order():
    drives = SourceClips(source_of(9, 8), 0, 2, LIMITS)
    epochs = [[tokens(drives, 9 * epoch + place) for place in range(9)] for epoch in range(3)]
    for epoch in epochs:
        assert sorted(chain.from_iterable(epoch)) == list(range(17))
    assert epochs[0] != epochs[1] != epochs[2] != epochs[0]
    assert epochs[0] == [tokens(SourceClips(source_of(9, 8), 0, 2, LIMITS), place) for place in range(9)]
    assert epochs[0] != [tokens(SourceClips(source_of(9, 8), 1, 2, LIMITS), place) for place in range(9)]


# --- How many -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("step", "expected"), [(0, range(6)), (4, range(2, 6)), (8, range(4, 6)), (10, range(6, 6))])
def test_drives_of_equal_length_come_in_groups_of_as_many_steps(step, expected):
    """Ten steps, two drives side by side, four frames each: three groups, the last of which ends early."""
    settings = settings_with(steps=10, batch_size=2, frames_per_clip=4)
    assert remaining_clips(SyntheticClips(0, 4, GRID), settings, step) == expected


def test_short_scenes_make_short_groups_and_no_early_end():
    """Pieces of 1 and 3 frames in turn, two side by side: each group has 3 steps; alone: 1, 3, 1, 3, ..."""
    frames = synthetic_frames(1, 3)
    drives = FixedClips((frames[:1], frames))
    side_by_side = settings_with(steps=7, batch_size=2, frames_per_clip=3)
    assert remaining_clips(drives, side_by_side, 0) == range(6)
    assert remaining_clips(drives, side_by_side, 3) == range(2, 6)
    alone = settings_with(steps=7, batch_size=1, frames_per_clip=3)
    assert remaining_clips(drives, alone, 0) == range(4)
    assert remaining_clips(drives, alone, 4) == range(2, 4)


# --- Loading ------------------------------------------------------------------------------------------------------


def loaded(drives, numbers, workers):
    return list(load_clips(drives, TINY, preprocessing(TINY), numbers, workers))


def test_a_worker_gives_the_same_samples_in_the_same_order_as_none():
    drives = SyntheticClips(0, 2, GRID)
    alone, ahead = (loaded(drives, range(3, 6), workers) for workers in (0, 1))
    assert [len(drive) for drive in ahead] == [2, 2, 2]
    for one, other in zip(chain.from_iterable(alone), chain.from_iterable(ahead), strict=True):
        assert all(torch.equal(a, b) for a, b in zip(one, other, strict=True))
    times = [float(drive[0].timestamp_s) for drive in alone]
    assert times == [drives.frames(number)[0].timestamp_s for number in range(3, 6)]


@pytest.mark.parametrize("workers", [0, 1])
def test_what_is_wrong_with_a_frame_is_told_in_the_same_words_from_a_worker(workers):
    good = synthetic_frames(1, 1)
    drives = FixedClips((good, [replace(good[0], ground_truth=None, token="the one")]))
    came = load_clips(drives, TINY, preprocessing(TINY), range(2), workers)
    assert len(next(came)) == 1
    with pytest.raises(InputError) as refusal:
        next(came)
    assert (
        str(refusal.value)
        == "frame the one: expected ground-truth boxes; got none. Train on a source with ground truth."
    )


def test_frames_keep_their_time_and_place_in_double_precision():
    (frame,) = synthetic_frames(1, 1)
    far = replace(frame, timestamp_s=1.5e9 + 1e-6)
    ((sample,),) = loaded(FixedClips(([far],)), range(1), 0)
    assert float(sample.timestamp_s) == 1.5e9 + 1e-6
    np.testing.assert_allclose(sample.global_T_ego.numpy(), frame.global_T_ego, atol=1e-12)
