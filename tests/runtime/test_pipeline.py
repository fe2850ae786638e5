from dataclasses import replace

import numpy as np
import pytest

from duospacenet.data.scene_folder import SceneFolder
from examples.nuscenes_scene import is_here, write_scene_folder
from tests.helpers.streams import bitwise_equal, detect_all, lose_cameras, record_sessions, turn_cameras

NUM_FRAMES = 4


def test_the_same_drive_gives_the_same_bits_again(pipeline, frames):
    first = detect_all(pipeline, frames, maps=True)
    for _ in range(3):
        assert all(bitwise_equal(a, b) for a, b in zip(first, detect_all(pipeline, frames, maps=True), strict=True))


def test_a_caller_may_write_on_his_arrays_after_a_step(pipeline, frames):
    stream, answers = pipeline.stream(), []
    for frame in frames[:4]:
        own = replace(
            frame,
            images={name: image.copy() for name, image in frame.images.items()},
            cameras={
                name: replace(c, intrinsics_px=c.intrinsics_px.copy(), camera_T_ego=c.camera_T_ego.copy())
                for name, c in frame.cameras.items()
            },
            global_T_ego=frame.global_T_ego.copy(),
        )
        answers.append(stream.step(own))
        own.global_T_ego[:] = np.nan
        for name, camera in own.cameras.items():
            own.images[name][:] = 0
            camera.intrinsics_px[:] = np.nan
            camera.camera_T_ego[:] = np.nan
    assert all(bitwise_equal(a, b) for a, b in zip(answers, detect_all(pipeline, frames[:4]), strict=True))


def test_what_frames_left_in_memory_is_bound_where_it_lies(pipeline, frames):
    watched, spies = record_sessions(pipeline)
    stream, left = watched.stream(), []
    nothing = {name: value.data_ptr() for name, value in watched.empty_memory.items()}
    for frame in frames:
        stream.step(frame)
        left.insert(0, spies["backbone"].outputs | spies["lifter"].outputs)
        for t in range(NUM_FRAMES):
            expected = left[t] if t < len(left) else nothing
            for name in pipeline.manifest.memory:
                assert spies["decoder"].inputs[f"slot{t}.{name}"] == expected[name]


def test_a_frame_passes_each_graph_once_and_the_projector_when_calibration_changes(pipeline, frames):
    watched, spies = record_sessions(pipeline)
    detect_all(watched, [frames[0], frames[1], turn_cameras(frames[2]), turn_cameras(frames[3])])
    runs = {name: spy.num_runs for name, spy in spies.items()}
    assert runs == {"projector": 2, "backbone": 4, "lifter": 4, "decoder": 4, "segmenter": 0}


def test_a_camera_that_is_lost_and_returns_asks_for_new_tables(pipeline, frames):
    watched, spies = record_sessions(pipeline)
    detect_all(
        watched, [frames[0], lose_cameras(frames[1], "CAM_FRONT"), lose_cameras(frames[2], "CAM_FRONT"), frames[3]]
    )
    assert spies["projector"].num_runs == 3


@pytest.mark.parametrize("graph", ["backbone", "lifter", "decoder"])
def test_a_step_that_breaks_off_changes_nothing(pipeline, frames, graph):
    def break_off(outputs):
        raise KeyboardInterrupt

    watched, spies = record_sessions(pipeline)
    stream, expected = watched.stream(), detect_all(pipeline, frames[:4])
    for frame in frames[:3]:
        stream.step(frame)
    spies[graph].spoil = break_off
    with pytest.raises(KeyboardInterrupt):
        stream.step(turn_cameras(frames[3]))
    spies[graph].spoil = dict
    assert bitwise_equal(stream.step(frames[3]), expected[3])


def test_a_step_leaves_its_frame_as_it_is(pipeline, frames):
    copies = {name: image.copy() for name, image in frames[0].images.items()}
    detect_all(pipeline, frames[:2])
    assert all(np.array_equal(frames[0].images[name], copies[name]) for name in copies)


def test_detections_say_which_frame_they_are_of(pipeline, frames):
    answer = detect_all(pipeline, [replace(frames[0], token="t0", scene="s")])[0]
    assert (answer.scene, answer.token, answer.timestamp_s) == ("s", "t0", frames[0].timestamp_s)
    assert answer.maps == {}
    assert set(answer.timings_s) == {"preprocess", "projector", "backbone", "lifter", "decoder", "postprocess"}
    assert list(answer.scores) == sorted(answer.scores, reverse=True)


@pytest.mark.skipif(not is_here(), reason="the nuScenes frames do not lie beside this checkout")
def test_real_frames_pass_from_a_scene_folder(pipeline, tmp_path):
    answers = detect_all(pipeline, SceneFolder(write_scene_folder(tmp_path / "real")), maps=True)
    assert [answer.history.frames for answer in answers] == [1, 2, 3, 4]
    assert [answer.history.reset_reason for answer in answers] == [None] * 4
    for answer in answers:
        assert len(answer) == 320
        assert answer.dropped_queries == 0
        assert np.isfinite(answer.boxes).all()
        assert all(np.isfinite(mask).all() for mask in answer.maps.values())


def test_where_the_ego_stands_changes_nothing_in_a_single_frame(pipeline, frames):
    """A pose that is rigid but for rounding must not scale the boxes of a cold start."""
    pose = frames[0].global_T_ego.copy()
    pose[:3, :3] *= 1 + 4.5e-4
    rounded = replace(frames[0], global_T_ego=pose)
    assert bitwise_equal(pipeline.stream().step(rounded), pipeline.stream().step(frames[0]))
