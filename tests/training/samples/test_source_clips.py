"""Tests of the clips of a source: where it is split, and which frames each epoch has."""

from dataclasses import replace
from itertools import chain

import numpy as np

from duospacenet.data.joined_source import JoinedSource
from duospacenet.runtime.frame import GroundTruth
from duospacenet.runtime.geometry import rotation_z
from duospacenet.training.samples.past_frames import PastFrames
from duospacenet.training.samples.source_clips import FrameClasses, SourceClips, SourceWindows
from duospacenet.weights.input_contract import temporal_window
from tests.helpers.trainings import TINY, FixedSource, synthetic_frames

LIMITS = temporal_window(TINY)  # 2 s, 70 m/s


def source_of(*scene_lengths):
    """A source with scenes of these lengths, at 2 Hz. The token of a frame is its index."""
    (frame,) = synthetic_frames(1, 1)
    names = [f"scene {number}" for number, length in enumerate(scene_lengths) for _ in range(length)]
    return FixedSource(
        [replace(frame, scene=name, token=str(i), timestamp_s=100 + 0.5 * i) for i, name in enumerate(names)]
    )


def tokens(clips, number):
    return [int(frame.token) for frame in clips.frames(number)]


def test_a_source_is_split_at_the_end_of_a_scene_and_after_a_number_of_frames():
    clips = SourceClips(source_of(5, 2, 4), 0, 2, LIMITS)
    assert sorted(tokens(clips, number) for number in range(6)) == [[0, 1], [2, 3], [4], [5, 6], [7, 8], [9, 10]]
    assert [clips.num_steps(number) for number in range(6)] == [len(tokens(clips, number)) for number in range(6)]


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
    assert sorted(clips.num_steps(number) for number in range(3)) == [1, 2, 2]
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


# --- Windows ------------------------------------------------------------------------------------------------------


def windows(source, past=2, strides=(1,), **changes):
    return SourceWindows(source, PastFrames(0, past, strides), LIMITS, **changes)


def samples_of_epoch(clips, epoch=0):
    count = clips.samples_per_epoch
    return [tokens(clips, number) for number in range(epoch * count, (epoch + 1) * count)]


def test_every_epoch_of_windows_has_every_frame_once_as_the_newest():
    clips = windows(source_of(5, 3))
    assert clips.samples_per_epoch == 8
    expected = [[0], [0, 1], [0, 1, 2], [1, 2, 3], [2, 3, 4], [5], [5, 6], [5, 6, 7]]
    epochs = [samples_of_epoch(clips, epoch) for epoch in range(3)]
    assert all(sorted(epoch) == sorted(expected) for epoch in epochs)
    assert epochs[0] != epochs[1] != epochs[2] != epochs[0]
    assert [clips.num_steps(number) for number in range(3)] == [1, 1, 1]


def test_windows_at_a_stride_stay_within_their_scene():
    expected = [[0], [1], [0, 2], [1, 3], [0, 2, 4], [5], [6], [5, 7]]
    assert sorted(samples_of_epoch(windows(source_of(5, 3), strides=(2,)))) == sorted(expected)


def test_a_window_starts_after_a_reset():
    late = FixedSource([replace(f, timestamp_s=f.timestamp_s + 2.1 * (i > 2)) for i, f in enumerate(source_of(5))])
    assert sorted(samples_of_epoch(windows(late))) == [[0], [0, 1], [0, 1, 2], [3], [3, 4]]


def test_a_window_starts_after_a_gap_between_its_frames_that_the_runtime_would_not_accept():
    """At 1.2 s per frame no frame resets the history, but at a stride of 2 the frames are 2.4 s apart."""
    slow = FixedSource([replace(f, timestamp_s=100 + 1.2 * i) for i, f in enumerate(source_of(4))])
    assert sorted(samples_of_epoch(windows(slow))) == [[0], [0, 1], [0, 1, 2], [1, 2, 3]]
    assert sorted(samples_of_epoch(windows(slow, strides=(2,)))) == [[0], [1], [2], [3]]


def test_a_window_at_a_stride_skips_over_frames_by_number_where_frames_are_missing():
    """Frame 2 is missing, so frame 4 is the third one left. Its past frame at a stride of 2 is 1.5 s old, not 1 s."""
    left = [frame for frame in source_of(5) if frame.token != "2"]
    assert sorted(samples_of_epoch(windows(FixedSource(left), past=1, strides=(2,)))) == [[0], [0, 3], [1], [1, 4]]


def test_a_window_never_spans_two_sources():
    whole = list(source_of(4))
    joined = JoinedSource([FixedSource(whole[:2]), FixedSource(whole[2:])])
    assert sorted(samples_of_epoch(windows(joined))) == [[0], [0, 1], [2], [2, 3]]


def test_a_window_reads_the_images_of_its_frames_only():
    read = []

    class Recorded(FixedSource):
        def frame(self, index):
            read.append(index)
            return super().frame(index)

    clips = windows(Recorded(list(source_of(5))), strides=(2,))
    assert clips.samples_per_epoch == 5
    assert clips.num_steps(0) == 1
    assert not read
    expected = list(chain.from_iterable(tokens(clips, number) for number in range(5)))
    assert read == expected


# --- Frames to train on -------------------------------------------------------------------------------------------


def test_windows_end_at_frames_with_ground_truth_and_other_frames_are_past_frames_only():
    clips = windows(source_of(5), past=1, trainable=frozenset({0, 3, 4}))
    assert clips.samples_per_epoch == 3
    assert sorted(samples_of_epoch(clips)) == [[0], [2, 3], [3, 4]]


def test_clips_without_any_ground_truth_are_left_out():
    clips = SourceClips(source_of(6), 0, 2, LIMITS, frozenset({0, 3, 2}))
    assert clips.samples_per_epoch == 4
    assert sorted(tokens(clips, number) for number in range(2)) == [[0, 1], [2, 3]]


# --- Class balance ------------------------------------------------------------------------------------------------


def test_class_balanced_windows_have_frames_with_a_rare_class_more_often():
    """Ten frames with cars, of which one has a bus too: 11 // 2 = 5 frames per class, and none of no class."""
    classes = FrameClasses(("car", "bus"), tuple(frozenset({"car", "bus"} if i == 3 else {"car"}) for i in range(10)))
    clips = windows(source_of(10), past=0, balance=classes)
    assert clips.samples_per_epoch == 10
    samples = samples_of_epoch(clips)
    assert samples.count([3]) >= 5
    assert samples == samples_of_epoch(windows(source_of(10), past=0, balance=classes))


def test_class_balanced_clips_count_the_classes_of_all_their_frames():
    """Clips of two frames: the second of five has the only bus. 6 // 2 = 3 clips per class."""
    classes = FrameClasses(("car", "bus"), tuple(frozenset({"bus"} if i == 2 else {"car"}) for i in range(10)))
    clips = SourceClips(source_of(10), 0, 2, LIMITS, balance=classes)
    assert clips.samples_per_epoch == 2 * 6
    assert [tokens(clips, number) for number in range(6)].count([2, 3]) >= 3
