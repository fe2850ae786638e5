"""Streams that are faster than the training data: the window has frames at the nominal step."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.runtime.errors import UsageError
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.streams import TINY_SIZE_PX, bitwise_equal, detect_all, record_sessions

STEP_S = 0.5


@pytest.fixture(scope="module")
def key_frames():
    return list(SyntheticDrive(1, frames=6, image_size=TINY_SIZE_PX))


def stream_at(key_frames, rate_hz, number, start_s=1.5e9, dropped=(), jitter_s=0.0):
    """A stream with the images of the key frames again and again, at 10 m/s. The token is the number of the frame."""
    offsets_s, frames = np.random.default_rng(0).uniform(-jitter_s, jitter_s, number), []
    for index in range(number):
        pose = key_frames[0].global_T_ego.copy()
        pose[0, 3] += 10.0 * index / rate_hz
        time_s = start_s + index / rate_hz + offsets_s[index]
        frame = key_frames[index % len(key_frames)]
        frames.append(replace(frame, global_T_ego=pose, timestamp_s=time_s, scene="s", token=str(index)))
    return [frame for index, frame in enumerate(frames) if index not in dropped]


def run(pipeline, frames, step_s=STEP_S):
    stream = pipeline.stream(maps=True, history_step_s=step_s)
    return [stream.step(frame) for frame in frames]


@pytest.mark.parametrize(("rate_hz", "interval"), [(10, 5), (12, 6)])
def test_a_fast_stream_gives_the_bits_of_a_stream_at_2_hz_of_the_chosen_frames(pipeline, key_frames, rate_hz, interval):
    frames = stream_at(key_frames, rate_hz, 3 * interval + 2)
    results = run(pipeline, frames)
    for last in (3 * interval, 3 * interval + 1):
        chosen = frames[last - 3 * interval : last + 1 : interval]
        slow = detect_all(pipeline, chosen, maps=True)[-1]
        assert bitwise_equal(results[last], slow)
        assert results[last].history == slow.history
        assert results[last].history.ages_s == pytest.approx([0.5, 1.0, 1.5], abs=1e-6)
    newest = detect_all(pipeline, frames[-4:], maps=True)[-1]
    assert not bitwise_equal(results[-1], newest)


def test_dropped_frames_and_jitter_choose_the_frames_worked_out_by_hand(pipeline, key_frames):
    """At 10 Hz, of the frames 0 to 17, the frames 11 to 14 are lost. The jitter of 5 ms decides nothing.

    The frames before frame 17 have the ages 0.1, 0.2, 0.7, 0.8, ... 0.7 is the nearest to 0.5, of those from 0.25 s
    on; 1.0 to 1.0, and 1.5 to 1.5.
    """
    frames = stream_at(key_frames, 10, 18, dropped=range(11, 15), jitter_s=0.005)
    result = run(pipeline, frames)[-1]
    chosen = [frame for frame in frames if frame.token in ("2", "7", "10", "17")]
    assert bitwise_equal(result, detect_all(pipeline, chosen, maps=True)[-1])
    assert result.history.ages_s == pytest.approx([0.7, 1.0, 1.5], abs=0.011)


def test_a_stream_at_2_hz_gives_the_same_bits_with_and_without_the_step(pipeline, key_frames):
    frames = stream_at(key_frames, 2, 10, dropped=(4, 5), jitter_s=0.05)
    with_step, without = run(pipeline, frames), detect_all(pipeline, frames, maps=True)
    assert all(bitwise_equal(one, other) for one, other in zip(with_step, without, strict=True))
    assert [one.history for one in with_step] == [other.history for other in without]
    assert [result.history.frames for result in without] == [1, 2, 3, 4, 4, 4, 4, 4]


def test_only_the_frames_that_later_windows_need_stay_in_memory(pipeline, key_frames):
    stream, slow = pipeline.stream(history_step_s=STEP_S), pipeline.stream()
    for number, frame in enumerate(stream_at(key_frames, 10, 22, start_s=0.0), start=1):
        stream.step(frame)
        slow.step(frame)
        assert stream.num_cached_frames <= min(number, 17)  # 1.5 s, and one more where a time is rounded down
        assert slow.num_cached_frames == min(number, 3)
    assert stream.num_cached_frames >= 16


def test_the_decoder_gets_the_true_ages_and_the_cached_values_of_the_chosen_frames(pipeline, key_frames):
    recorded, recorders = record_sessions(pipeline)
    stream, cached, seen = recorded.stream(history_step_s=STEP_S), [], []
    run_decoder = recorders["decoder"].run
    recorders["decoder"].run = lambda inputs: (seen.append(inputs["time_delta_s"].numpy().copy()), run_decoder(inputs))[
        1
    ]
    for frame in stream_at(key_frames, 12, 20, start_s=100.0, jitter_s=0.01):
        cached.insert(0, (frame, None))
        ages_s = stream.step(frame).history.ages_s
        cached[0] = (frame, recorders["backbone"].outputs | recorders["lifter"].outputs)
        by_age = {frame.timestamp_s - past.timestamp_s: values for past, values in cached}
        np.testing.assert_array_equal(seen[-1][1 : 1 + len(ages_s)], np.float32(ages_s))
        for slot, age_s in enumerate(ages_s, start=1):
            for name in pipeline.manifest.memory:
                assert recorders["decoder"].inputs[f"slot{slot}.{name}"] == by_age[age_s][name]
    assert len(ages_s) == 3


def test_after_a_reset_the_step_stays_and_the_history_is_empty(pipeline, key_frames):
    frames = stream_at(key_frames, 10, 8)
    stream = pipeline.stream(maps=True, history_step_s=STEP_S)
    for frame in frames:
        stream.step(frame)
    stream.reset()
    assert stream.num_cached_frames == 0
    again = [stream.step(frame) for frame in frames]
    other_scene = [stream.step(replace(frame, scene="t")) for frame in frames]
    expected = run(pipeline, frames)
    for results in (again, other_scene):
        assert all(bitwise_equal(one, other) for one, other in zip(results, expected, strict=True))


def test_a_step_beyond_the_manifests_largest_gap_is_refused(pipeline):
    with pytest.raises(UsageError, match=r"history step: expected 0\.01 to 2 s"):
        pipeline.stream(history_step_s=2.5)
