"""Reliability rows S1 to S5: lost cameras, time, resets, poisoned histories and parallel streams."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime import Pipeline
from duospacenet.runtime.errors import InputError, UsageError
from duospacenet.runtime.geometry import rigid_transform, rotation_z
from duospacenet.runtime.history import History, PastFrame
from duospacenet.runtime.preprocessing import prepare
from duospacenet.runtime.session import to_tensors
from duospacenet.synthetic.drive import SyntheticDrive
from tests.helpers.streams import (
    TINY_SIZE_PX,
    bitwise_equal,
    detect_all,
    lose_cameras,
    move_ego,
    turn_cameras,
    with_camera,
)

# --- S1: lost cameras ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("num_lost", [1, 2, 3, 4, 5])
def test_s1_the_calibration_of_a_lost_camera_has_no_influence(pipeline, frames, num_lost):
    frame = frames[0]
    names = list(frame.cameras)[:num_lost]
    without_cameras = lose_cameras(frame, *names)
    other_calibration = without_cameras
    for name in names:
        camera = turn_cameras(frame).cameras[name]
        other_calibration = with_camera(other_calibration, name, **vars(camera))
    kept = [name for name in frame.cameras if name not in names]
    smaller = replace(frame, images={n: frame.images[n] for n in kept}, cameras={n: frame.cameras[n] for n in kept})
    (expected,) = detect_all(pipeline, [smaller])
    (result,) = detect_all(pipeline, [without_cameras])
    assert bitwise_equal(result, detect_all(pipeline, [other_calibration])[0])
    assert not bitwise_equal(result, detect_all(pipeline, [frame])[0])
    order, expected_order = (np.lexsort((d.classes, d.queries)) for d in (result, expected))
    np.testing.assert_array_equal(result.queries[order], expected.queries[expected_order])
    np.testing.assert_allclose(result.boxes[order], expected.boxes[expected_order], atol=1e-4)
    np.testing.assert_allclose(result.scores[order], expected.scores[expected_order], atol=1e-4)


@pytest.mark.parametrize("num_lost", [1, 2, 3, 4, 5])
def test_s1_a_stream_continues_through_lost_cameras(pipeline, frames, num_lost):
    names = list(frames[0].cameras)[-num_lost:]
    results = detect_all(pipeline, [frames[0], lose_cameras(frames[1], *names), frames[2]])
    assert [result.history.frames for result in results] == [1, 2, 3]
    assert all(len(result) == 320 and result.dropped_queries == 0 for result in results)


@pytest.mark.parametrize("num_lost", [1, 2, 3, 4, 5])
def test_s1_a_skipped_frame_does_not_change_the_history(pipeline, frames, num_lost):
    names = list(frames[0].cameras)[:num_lost]
    stream = pipeline.stream(on_missing="skip")
    results = [stream.step(frame) for frame in (frames[0], lose_cameras(frames[1], *names), frames[2])]
    assert (results[1].skipped, len(results[1]), results[1].history.frames) == (f"lost: {', '.join(names)}", 0, 0)
    assert (results[1].token, results[1].timestamp_s) == (frames[1].token, frames[1].timestamp_s)
    expected = detect_all(pipeline, [frames[0], frames[2]])
    assert bitwise_equal(results[0], expected[0])
    assert bitwise_equal(results[2], expected[1])


@pytest.mark.parametrize("num_lost", [1, 2, 3, 4, 5, 6])
def test_s1_with_policy_error_a_lost_camera_is_refused_and_does_not_change_the_history(pipeline, frames, num_lost):
    stream = pipeline.stream(on_missing="error")
    names = list(frames[0].cameras)[:num_lost]
    first = stream.step(frames[0])
    with pytest.raises(InputError, match=rf"camera {names[0]}: expected an image; got a lost camera"):
        stream.step(lose_cameras(frames[1], *names))
    assert all(
        bitwise_equal(a, b)
        for a, b in zip([first, stream.step(frames[1])], detect_all(pipeline, frames[:2]), strict=True)
    )


@pytest.mark.parametrize("policy", ["blank", "skip"])
def test_s1_a_frame_without_any_image_is_skipped(pipeline, frames, policy):
    stream = pipeline.stream(maps=True, on_missing=policy)
    results = [stream.step(frame) for frame in (frames[0], lose_cameras(frames[1], *frames[1].cameras), frames[2])]
    assert (results[1].skipped, len(results[1]), dict(results[1].maps)) == ("every camera is lost", 0, {})
    assert results[2].history.frames == 2


def test_s1_an_unused_camera_slot_is_not_a_lost_camera(pipeline, frames):
    names = list(frames[0].cameras)[:4]
    smaller_rig = replace(
        frames[0],
        images={name: frames[0].images[name] for name in names},
        cameras={name: frames[0].cameras[name] for name in names},
    )
    assert pipeline.stream(on_missing="error").step(smaller_rig).skipped is None


def test_s1_an_old_time_stamp_is_refused_even_if_the_frame_would_be_skipped(pipeline, frames):
    stream = pipeline.stream(on_missing="skip")
    stream.step(frames[1])
    with pytest.raises(InputError, match="timestamp_s: expected later"):
        stream.step(lose_cameras(frames[0], "CAM_BACK"))


def test_s1_an_unknown_policy_is_refused(pipeline):
    with pytest.raises(UsageError, match="on_missing: expected blank, skip or error; got 'ignore'"):
        pipeline.stream(on_missing="ignore")


@pytest.mark.parametrize(("policy", "boxes"), [("blank", [320, 320, 0]), ("skip", [320, 0, 0])])
def test_s1_every_sample_is_in_the_submission(tiny_bundle, frames, tmp_path, policy, boxes):
    lost = [frames[0], lose_cameras(frames[1], "CAM_FRONT", "CAM_BACK"), lose_cameras(frames[2], *frames[2].cameras)]
    write_scene(tmp_path / "scene", lost)
    out = tmp_path / "out"
    call = ["run", str(tiny_bundle), str(tmp_path / "scene"), "--out", str(out), "--format", "nuscenes"]
    assert run_app([*call, "--on-missing", policy]) == 0
    submission = json.loads((out / "results_nusc.json").read_text())["results"]
    assert {token: len(sample) for token, sample in submission.items()} == {
        frame.token: number for frame, number in zip(lost, boxes, strict=True)
    }
    records = [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()]
    assert records[2]["skipped"] == "every camera is lost"


def test_s1_a_run_with_policy_error_ends_at_a_lost_camera(tiny_bundle, frames, tmp_path, capfd):
    write_scene(tmp_path / "scene", [frames[0], lose_cameras(frames[1], "CAM_BACK")])
    call = ["run", str(tiny_bundle), str(tmp_path / "scene"), "--out", str(tmp_path / "out")]
    assert run_app([*call, "--on-missing", "error"]) == 3
    assert (
        "frame 1: camera CAM_BACK: expected an image, because of --on-missing error; got a lost camera"
        in capfd.readouterr().err
    )
    assert run_app([*call, "--overwrite", "--on-missing", "ignore"]) == 2


# --- S2: gaps, scene changes, ego jumps ---------------------------------------------------------------------------


@pytest.mark.parametrize(("gap_s", "frames_held"), [(0.5, 2), (1.99, 2), (2.01, 1)])
def test_s2_a_gap_above_two_seconds_resets_the_history(pipeline, frames, gap_s, frames_held):
    later = replace(frames[1], timestamp_s=frames[0].timestamp_s + gap_s)
    result = detect_all(pipeline, [frames[0], later])[1]
    assert result.history.frames == frames_held
    if frames_held == 1:
        assert result.history.reset_reason == "gap of 2.01 s, above 2 s"
        assert bitwise_equal(result, detect_all(pipeline, [later])[0])
    else:
        assert result.history.reset_reason is None


@pytest.mark.parametrize(("distance_m", "frames_held"), [(1.0, 3), (10.0, 3), (100.0, 1), (1e4, 1)])
def test_s2_an_impossible_jump_resets_the_history(pipeline, frames, distance_m, frames_held):
    jumped = move_ego(replace(frames[2], global_T_ego=frames[1].global_T_ego), distance_m)
    result = detect_all(pipeline, [*frames[:2], jumped])[2]
    assert result.history.frames == frames_held
    if frames_held == 1:
        assert result.history.reset_reason.startswith(f"ego jump of {distance_m:.1f} m in 0.")
        assert bitwise_equal(result, detect_all(pipeline, [jumped])[0])
    else:
        assert result.history.reset_reason is None


@pytest.mark.parametrize(("turn_deg", "frames_held"), [(5, 3), (80, 3), (100, 1), (180, 1)])
def test_s2_an_impossible_turn_resets_the_history(pipeline, frames, turn_deg, frames_held):
    """The limit is 180 degrees per second, so 90 degrees between frames that are half a second apart."""
    pose = frames[1].global_T_ego @ rigid_transform(rotation_z(np.radians(turn_deg)), [0, 0, 0])
    jumped = replace(frames[2], global_T_ego=pose, timestamp_s=frames[1].timestamp_s + 0.5)
    result = detect_all(pipeline, [*frames[:2], jumped])[2]
    assert result.history.frames == frames_held
    if frames_held == 1:
        assert result.history.reset_reason == f"ego turn of {turn_deg} degrees in 0.50 s"
        assert bitwise_equal(result, detect_all(pipeline, [jumped])[0])
    else:
        assert result.history.reset_reason is None


def test_s2_scenes_share_no_history(pipeline, frames, other_frames):
    first, second = frames[:3], other_frames[:3]
    alone = [*detect_all(pipeline, first, maps=True), *detect_all(pipeline, second, maps=True)]
    after = detect_all(pipeline, [*first, *second], maps=True)
    before = detect_all(pipeline, [*second, *first], maps=True)
    assert after[3].history.reset_reason == "new scene 'synthetic-2' after 'synthetic-1'"
    assert all(bitwise_equal(a, b) for a, b in zip(after, alone, strict=True))
    assert all(bitwise_equal(a, b) for a, b in zip(before, alone[3:] + alone[:3], strict=True))


def test_s2_a_stream_equals_a_new_stream_after_a_reset(pipeline, frames):
    stream = pipeline.stream()
    for frame in frames[:4]:
        stream.step(frame)
    stream.reset()
    again = [stream.step(frame) for frame in frames[:2]]
    assert all(bitwise_equal(a, b) for a, b in zip(again, detect_all(pipeline, frames[:2]), strict=True))


# --- S3: duplicate and older time stamps --------------------------------------------------------------------------


def test_s3_duplicates_are_refused_and_do_not_change_the_history(pipeline, frames):
    stream, results = pipeline.stream(), []
    for frame in frames:
        results.append(stream.step(frame))
        with pytest.raises(InputError, match=r"timestamp_s: expected later than"):
            stream.step(frame)
    assert all(bitwise_equal(a, b) for a, b in zip(results, detect_all(pipeline, frames), strict=True))


def test_s3_an_older_frame_is_refused_and_does_not_change_the_history(pipeline, frames):
    stream = pipeline.stream()
    for frame in frames[:3]:
        stream.step(frame)
    for older in (frames[0], frames[1], move_ego(frames[2], 0.0, -1e-6)):
        with pytest.raises(InputError, match=r"timestamp_s: expected later than .* got "):
            stream.step(older)
    assert bitwise_equal(stream.step(frames[3]), detect_all(pipeline, frames[:4])[3])


def test_s3_another_scene_may_be_earlier(pipeline, frames):
    earlier = replace(frames[0], scene="yesterday", timestamp_s=frames[0].timestamp_s - 86400)
    assert [d.history.frames for d in detect_all(pipeline, [frames[1], earlier])] == [1, 1]


def test_s3_a_window_of_one_frame_still_remembers_the_last_time_stamp(pipeline, frames):
    window = pipeline.manifest.window.model_copy(update={"num_frames": 1})
    history = History(pipeline.manifest.model_copy(update={"window": window}))
    past = PastFrame.of(frames[1], prepare(frames[1], pipeline.manifest.preprocessing, 6), pipeline.empty_memory)
    history = history.after(past)
    for frame in frames[:2]:
        with pytest.raises(InputError, match="timestamp_s: expected later"):
            history.reset_reason(frame)
    inputs, ages_s = history.decoder_inputs(past, pipeline.empty_memory)
    assert ages_s == ()
    assert inputs["frame_valid"].numpy().tolist() == [True]


# --- S4: poisoned history ----------------------------------------------------------------------------------------


def poison(stream):
    """Replace every number in the history by NaN."""
    past_frames = stream._history._past
    assert len(past_frames) == 3
    for past in past_frames:
        for value in past.memory.values():
            value.update_inplace(np.full(value.shape(), np.nan, np.float32))
            assert np.isnan(value.numpy()).all()
        past.image_T_ego[:] = np.nan
        past.global_T_ego[:] = np.nan


def test_s4_a_new_scene_removes_a_poisoned_history(pipeline, frames, other_frames):
    stream = pipeline.stream(maps=True)
    for frame in frames[:4]:
        stream.step(frame)
    poison(stream)
    results = [stream.step(frame) for frame in other_frames[:4]]
    assert all(bitwise_equal(a, b) for a, b in zip(results, detect_all(pipeline, other_frames[:4], True), strict=True))


def test_s4_a_reset_removes_a_poisoned_history(pipeline, frames):
    stream = pipeline.stream()
    for frame in frames[:4]:
        stream.step(frame)
    poison(stream)
    stream.reset()
    assert bitwise_equal(stream.step(frames[4]), detect_all(pipeline, frames[4:5])[0])


def test_s4_a_poisoned_history_gives_degraded_but_finite_detections(pipeline, frames):
    stream = pipeline.stream()
    for frame in frames[:4]:
        stream.step(frame)
    for value in stream._history._past[0].memory.values():
        value.update_inplace(np.full(value.shape(), np.nan, np.float32))
    result = stream.step(frames[4])
    assert result.degraded
    assert np.isfinite(result.boxes).all()


def test_s4_the_values_in_empty_slots_have_no_influence(pipeline, frames):
    poisoned = Pipeline(pipeline.manifest, pipeline.sessions)
    poisoned.empty_memory = to_tensors(
        **{name: np.full(value.shape(), np.nan, np.float32) for name, value in pipeline.empty_memory.items()}
    )
    results = zip(detect_all(poisoned, frames[:4]), detect_all(pipeline, frames[:4]), strict=True)
    assert all(bitwise_equal(a, b) for a, b in results)


# --- S5: several streams in one process ---------------------------------------------------------------------------


def test_s5_eight_streams_in_eight_threads_equal_eight_streams_in_sequence(pipeline):
    drives = [list(SyntheticDrive(seed, frames=6, image_size=TINY_SIZE_PX)) for seed in range(10, 18)]
    serial = [detect_all(pipeline, frames) for frames in drives]
    for _ in range(3):
        with ThreadPoolExecutor(8) as threads:
            parallel = list(threads.map(lambda frames: detect_all(pipeline, frames), drives))
        for one, other in zip(serial, parallel, strict=True):
            assert all(bitwise_equal(a, b) for a, b in zip(one, other, strict=True))


def test_s5_streams_of_one_pipeline_share_no_history(pipeline, frames, other_frames):
    one, other = pipeline.stream(), pipeline.stream()
    results = [(one.step(a), other.step(b)) for a, b in zip(frames, other_frames, strict=True)]
    for alternating, alone in zip(zip(*results, strict=True), (frames, other_frames), strict=True):
        assert all(bitwise_equal(a, b) for a, b in zip(alternating, detect_all(pipeline, alone), strict=True))
