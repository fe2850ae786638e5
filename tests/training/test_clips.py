"""Tests of the clips: which frames a clip number gives, and where a source is split."""

from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

from duospacenet.data.joined_source import JoinedSource
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.frame import GroundTruth
from duospacenet.runtime.geometry import rotation_z
from duospacenet.synthetic.drive import FIRST_TRAINING_SEED, SyntheticDrive
from duospacenet.training.clips import MAX_CLIPS, SourceClips, SyntheticClips
from duospacenet.weights.input_contract import temporal_window
from tests.helpers.trainings import TINY, FixedSource, synthetic_frames

GRID = TINY.voxels.size[:2]
LIMITS = temporal_window(TINY)  # 2 s, 70 m/s


def source_of(*scene_lengths):
    """A source with scenes of these lengths, at 2 Hz. The token of a frame is its index."""
    (frame,) = synthetic_frames(1, 1)
    names = [f"scene {number}" for number, length in enumerate(scene_lengths) for _ in range(length)]
    return FixedSource(
        [replace(frame, scene=name, token=str(i), timestamp_s=100 + 0.5 * i) for i, name in enumerate(names)]
    )


def have_same_images(one, other):
    """Whether two frames have equal images and poses."""
    assert one.images.keys() == other.images.keys()
    return np.array_equal(one.global_T_ego, other.global_T_ego) and all(
        np.array_equal(image, other.images[name]) for name, image in one.images.items()
    )


def tokens(clips, number):
    return [int(frame.token) for frame in clips.frames(number)]


# --- Synthetic clips ----------------------------------------------------------------------------------------------


def test_no_training_seed_can_be_written_as_a_synthetic_source():
    lowest = SyntheticClips(0, 1, GRID).frames(0)[0].scene.removeprefix("synthetic-")
    assert int(lowest) == FIRST_TRAINING_SEED == 10**18
    assert len(lowest) == 19
    assert SyntheticDrive.parse("synthetic:" + "9" * 18).seed < FIRST_TRAINING_SEED
    with pytest.raises(InputError, match="expected synthetic:SEED"):
        SyntheticDrive.parse(f"synthetic:{lowest}")


def test_a_number_always_gives_the_same_frames_and_another_number_gives_others():
    first, again, other = (SyntheticClips(3, 2, GRID).frames(number) for number in (5, 5, 6))
    assert len(first) == SyntheticClips(3, 2, GRID).length(5) == 2
    assert all(have_same_images(one, two) for one, two in zip(first, again, strict=True))
    assert not have_same_images(first[0], other[0])
    assert first[0].ground_truth.maps["drivable_area"].shape == GRID


@pytest.mark.parametrize("length", [1, 2])
def test_anchors_come_from_a_fixed_number_of_frames_for_any_clip_length(length, monkeypatch):
    monkeypatch.setattr("duospacenet.training.clips.ANCHOR_FRAMES", 3)
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


# --- Clips of a source --------------------------------------------------------------------------------------------


def test_a_source_is_split_at_the_end_of_a_scene_and_after_a_number_of_frames():
    clips = SourceClips(source_of(5, 2, 4), 0, 2, LIMITS)
    assert sorted(tokens(clips, number) for number in range(6)) == [[0, 1], [2, 3], [4], [5, 6], [7, 8], [9, 10]]
    assert [clips.length(number) for number in range(6)] == [len(tokens(clips, number)) for number in range(6)]


def changed(source, index, **changes):
    """The source with these changes to frame `index`."""
    frames = list(source)
    frames[index] = replace(frames[index], **changes)
    return FixedSource(frames)


def test_a_source_is_split_where_the_runtime_resets_the_history():
    """First, frames 3 and 4 are 2.1 s late. Then frame 2 is 100 m away from the frames around it."""
    late = FixedSource([replace(f, timestamp_s=f.timestamp_s + 2.1 * (i > 2)) for i, f in enumerate(source_of(5))])
    assert sorted(tokens(SourceClips(late, 0, 9, LIMITS), number) for number in range(2)) == [[0, 1, 2], [3, 4]]
    away = np.array(next(iter(source_of(1))).global_T_ego)
    away[0, 3] += 100
    jumps = changed(source_of(5), 2, global_T_ego=away)
    assert sorted(tokens(SourceClips(jumps, 0, 9, LIMITS), number) for number in range(3)) == [[0, 1], [2], [3, 4]]


def test_a_source_is_split_where_the_ego_turns_on_the_spot():
    turned = np.array(next(iter(source_of(1))).global_T_ego)
    turned[:3, :3] = turned[:3, :3] @ rotation_z(np.pi)
    frames = [replace(f, global_T_ego=turned) if i > 1 else f for i, f in enumerate(source_of(4))]
    assert LIMITS.largest_turn_rad_s * 0.5 < np.pi
    clips = SourceClips(FixedSource(frames), 0, 9, LIMITS)
    assert sorted(tokens(clips, number) for number in range(2)) == [[0, 1], [2, 3]]


def test_no_image_is_read_to_split_a_source_or_to_find_its_ground_truth():
    class WithoutImages(FixedSource):
        def frame(self, index):
            raise AssertionError(f"frame {index} was read")

    moved = [replace(frame, ground_truth=with_one_box(index)) for index, frame in enumerate(source_of(3, 2))]
    clips = SourceClips(WithoutImages(moved), 0, 2, LIMITS)
    assert sorted(clips.length(number) for number in range(3)) == [1, 2, 2]
    assert [ground_truth.boxes[:, 0].tolist() for ground_truth in clips.ground_truth()] == [[k] for k in range(5)]


def with_one_box(x_m):
    return GroundTruth(np.array([[x_m, 0, 0, 1, 1, 1, 0, 0, 0.0]]), ("car",))


def test_the_identity_of_source_clips_depends_on_the_source_and_on_every_limit():
    sources = (source_of(3), replace(source_of(3), identity="others"))
    longer = LIMITS.model_copy(update={"largest_time_delta_s": 3.0})
    slower = LIMITS.model_copy(update={"largest_speed_m_s": 30.0})
    less_turn = LIMITS.model_copy(update={"largest_turn_rad_s": 1.0})
    all_limits = (LIMITS, longer, slower, less_turn)
    assert len({SourceClips(source, 0, 2, limits).identity for source in sources for limits in all_limits}) == 8


def test_every_epoch_has_every_frame_once_and_the_clips_in_another_order():
    clips = SourceClips(source_of(9, 8), 0, 2, LIMITS)
    epochs = [[tokens(clips, 9 * epoch + position) for position in range(9)] for epoch in range(3)]
    for epoch in epochs:
        assert sorted(chain.from_iterable(epoch)) == list(range(17))
    assert epochs[0] != epochs[1] != epochs[2] != epochs[0]
    assert epochs[0] == [tokens(SourceClips(source_of(9, 8), 0, 2, LIMITS), position) for position in range(9)]
    assert epochs[0] != [tokens(SourceClips(source_of(9, 8), 1, 2, LIMITS), position) for position in range(9)]


def test_a_clip_never_spans_two_sources():
    """The second source goes on with the scene of the first, half a second later and at the same place."""
    whole = list(source_of(6))
    joined = JoinedSource([FixedSource(whole[:3]), FixedSource(whole[3:])])
    assert sorted(tokens(SourceClips(FixedSource(whole), 0, 9, LIMITS), number) for number in range(1)) == [
        [0, 1, 2, 3, 4, 5]
    ]
    clips = SourceClips(joined, 0, 9, LIMITS)
    assert sorted(tokens(clips, number) for number in range(2)) == [[0, 1, 2], [3, 4, 5]]
