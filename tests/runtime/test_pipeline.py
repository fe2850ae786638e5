from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from driving import TINY_SIZE_PX, drive, lose, moved, same_bits, turned_rig, with_camera
from nuscenes_scene import is_here, write_scene_folder

from duospacenet.runtime import Pipeline
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.session import tensors
from duospacenet.runtime.sources.scene_folder import SceneFolder
from duospacenet.runtime.sources.synthetic import SyntheticDrive

NUM_FRAMES = 4


@pytest.mark.parametrize("num_lost", [1, 2, 3, 4, 5])
def test_a_lost_camera_has_no_influence(pipeline, frames, num_lost):
    frame = frames[0]
    names = list(frame.cameras)[:num_lost]
    blind = lose(frame, *names)
    elsewhere = blind
    for name in names:
        camera = turned_rig(frame).cameras[name]
        elsewhere = with_camera(elsewhere, name, **vars(camera))
    kept = [name for name in frame.cameras if name not in names]
    smaller = replace(frame, images={n: frame.images[n] for n in kept}, cameras={n: frame.cameras[n] for n in kept})
    (expected,) = drive(pipeline, [smaller])
    (answer,) = drive(pipeline, [blind])
    assert same_bits(answer, drive(pipeline, [elsewhere])[0])
    assert not same_bits(answer, drive(pipeline, [frame])[0])
    order, expected_order = (np.lexsort((d.classes, d.queries)) for d in (answer, expected))
    np.testing.assert_array_equal(answer.queries[order], expected.queries[expected_order])
    np.testing.assert_allclose(answer.boxes[order], expected.boxes[expected_order], atol=1e-4)
    np.testing.assert_allclose(answer.scores[order], expected.scores[expected_order], atol=1e-4)


@pytest.mark.parametrize("num_lost", [1, 2, 3, 4, 5, 6])
def test_a_stream_survives_lost_cameras(pipeline, frames, num_lost):
    names = list(frames[0].cameras)[-num_lost:]
    answers = drive(pipeline, [frames[0], lose(frames[1], *names), frames[2]])
    assert [answer.history.frames for answer in answers] == [1, 2, 3]
    assert all(len(answer) == 320 and answer.dropped == 0 for answer in answers)


# ---------------------------------------------------------------------------------------------------------------------
# When history is kept and when it is dropped


@pytest.mark.parametrize(("gap_s", "frames_held"), [(0.5, 2), (1.99, 2), (2.01, 1)])
def test_a_gap_above_two_seconds_drops_the_history(pipeline, frames, gap_s, frames_held):
    later = replace(frames[1], timestamp_s=frames[0].timestamp_s + gap_s)
    answer = drive(pipeline, [frames[0], later])[1]
    assert answer.history.frames == frames_held
    if frames_held == 1:
        assert answer.history.reset_reason == "gap of 2.01 s, above 2 s"
        assert same_bits(answer, drive(pipeline, [later])[0])
    else:
        assert answer.history.reset_reason is None


@pytest.mark.parametrize(("distance_m", "frames_held"), [(1.0, 3), (10.0, 3), (100.0, 1), (1e4, 1)])
def test_a_jump_that_no_vehicle_makes_drops_the_history(pipeline, frames, distance_m, frames_held):
    there = moved(replace(frames[2], global_T_ego=frames[1].global_T_ego), distance_m)
    answer = drive(pipeline, [*frames[:2], there])[2]
    assert answer.history.frames == frames_held
    if frames_held == 1:
        assert answer.history.reset_reason.startswith(f"ego jump of {distance_m:.1f} m in 0.")
        assert same_bits(answer, drive(pipeline, [there])[0])
    else:
        assert answer.history.reset_reason is None


def test_scenes_share_no_history(pipeline, frames, other_frames):
    first, second = frames[:3], other_frames[:3]
    alone = [*drive(pipeline, first, maps=True), *drive(pipeline, second, maps=True)]
    after = drive(pipeline, [*first, *second], maps=True)
    before = drive(pipeline, [*second, *first], maps=True)
    assert after[3].history.reset_reason == "new scene 'synthetic-2' after 'synthetic-1'"
    assert all(same_bits(a, b) for a, b in zip(after, alone, strict=True))
    assert all(same_bits(a, b) for a, b in zip(before, alone[3:] + alone[:3], strict=True))


def test_after_a_reset_the_stream_answers_as_a_new_one(pipeline, frames):
    stream = pipeline.stream()
    for frame in frames[:4]:
        stream.step(frame)
    stream.reset()
    again = [stream.step(frame) for frame in frames[:2]]
    assert all(same_bits(a, b) for a, b in zip(again, drive(pipeline, frames[:2]), strict=True))


def test_every_frame_twice_is_every_frame_once(pipeline, frames):
    stream, answers = pipeline.stream(), []
    for frame in frames:
        answers.append(stream.step(frame))
        with pytest.raises(InputError, match=r"timestamp_s: expected later than"):
            stream.step(frame)
    assert all(same_bits(a, b) for a, b in zip(answers, drive(pipeline, frames), strict=True))


def test_an_older_frame_is_refused_and_changes_nothing(pipeline, frames):
    stream = pipeline.stream()
    for frame in frames[:3]:
        stream.step(frame)
    for older in (frames[0], frames[1], moved(frames[2], 0.0, -1e-6)):
        with pytest.raises(InputError, match=r"timestamp_s: expected later than .* got "):
            stream.step(older)
    assert same_bits(stream.step(frames[3]), drive(pipeline, frames[:4])[3])


def test_another_scene_may_lie_earlier_in_time(pipeline, frames):
    earlier = replace(frames[0], scene="yesterday", timestamp_s=frames[0].timestamp_s - 86400)
    assert [d.history.frames for d in drive(pipeline, [frames[1], earlier])] == [1, 1]


def poison(stream):
    """NaN wherever the history holds a number."""
    moments = stream._history._past
    assert len(moments) == 3
    for moment in moments:
        for value in moment.memory.values():
            value.update_inplace(np.full(value.shape(), np.nan, np.float32))
            assert np.isnan(value.numpy()).all()
        moment.image_T_ego[:] = np.nan
        moment.global_T_ego[:] = np.nan


def test_poison_in_the_history_ends_with_the_scene(pipeline, frames, other_frames):
    stream = pipeline.stream(maps=True)
    for frame in frames[:4]:
        stream.step(frame)
    poison(stream)
    answers = [stream.step(frame) for frame in other_frames[:4]]
    assert all(same_bits(a, b) for a, b in zip(answers, drive(pipeline, other_frames[:4], True), strict=True))


def test_poison_in_the_history_ends_with_a_reset(pipeline, frames):
    stream = pipeline.stream()
    for frame in frames[:4]:
        stream.step(frame)
    poison(stream)
    stream.reset()
    assert same_bits(stream.step(frames[4]), drive(pipeline, frames[4:5])[0])


def test_a_poisoned_history_is_seen_while_it_lasts(pipeline, frames):
    stream = pipeline.stream()
    for frame in frames[:4]:
        stream.step(frame)
    for value in stream._history._past[0].memory.values():
        value.update_inplace(np.full(value.shape(), np.nan, np.float32))
    answer = stream.step(frames[4])
    assert answer.degraded
    assert np.isfinite(answer.boxes).all()


def test_whatever_stands_in_empty_slots_changes_nothing(pipeline, frames):
    haunted = Pipeline(pipeline.manifest, pipeline.sessions)
    haunted.empty_memory = tensors(
        **{name: np.full(value.shape(), np.nan, np.float32) for name, value in pipeline.empty_memory.items()}
    )
    answers = zip(drive(haunted, frames[:4]), drive(pipeline, frames[:4]), strict=True)
    assert all(same_bits(a, b) for a, b in answers)


def test_four_streams_in_four_threads_answer_as_one_after_the_other(pipeline):
    drives = [list(SyntheticDrive(seed, frames=6, image_size=TINY_SIZE_PX)) for seed in range(10, 14)]
    serial = [drive(pipeline, frames) for frames in drives]
    for _ in range(3):
        with ThreadPoolExecutor(4) as threads:
            parallel = list(threads.map(lambda frames: drive(pipeline, frames), drives))
        for one, other in zip(serial, parallel, strict=True):
            assert all(same_bits(a, b) for a, b in zip(one, other, strict=True))


def test_streams_of_one_pipeline_share_no_history(pipeline, frames, other_frames):
    one, other = pipeline.stream(), pipeline.stream()
    answers = [(one.step(a), other.step(b)) for a, b in zip(frames, other_frames, strict=True)]
    for alternating, alone in zip(zip(*answers, strict=True), (frames, other_frames), strict=True):
        assert all(same_bits(a, b) for a, b in zip(alternating, drive(pipeline, alone), strict=True))


def test_the_same_drive_gives_the_same_bits_again(pipeline, frames):
    first = drive(pipeline, frames, maps=True)
    for _ in range(3):
        assert all(same_bits(a, b) for a, b in zip(first, drive(pipeline, frames, maps=True), strict=True))


def strided(array):
    """The same numbers, every other one of an array of twice the size in each direction."""
    wide = np.zeros([2 * size for size in array.shape], array.dtype)
    view = wide[tuple(slice(None, None, 2) for _ in array.shape)]
    view[...] = array
    return view


def read_only(array):
    array = array.copy()
    array.setflags(write=False)
    return array


LAYOUTS = {
    "big-endian": lambda array: array.astype(array.dtype.newbyteorder(">")),
    "strided": strided,
    "column-major": np.asfortranarray,
    "backwards": lambda array: array[::-1].copy()[::-1],
    "read-only": read_only,
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_layout_of_an_array_does_not_matter(pipeline, large_frames, layout):
    lay_out = LAYOUTS[layout]
    frames = [
        replace(
            frame,
            images={name: lay_out(image) for name, image in frame.images.items()},
            cameras={
                name: replace(c, intrinsics_px=lay_out(c.intrinsics_px), camera_T_ego=lay_out(c.camera_T_ego))
                for name, c in frame.cameras.items()
            },
            global_T_ego=lay_out(frame.global_T_ego),
        )
        for frame in large_frames
    ]
    answers = zip(drive(pipeline, frames), drive(pipeline, large_frames), strict=True)
    assert all(same_bits(a, b) for a, b in answers)


@pytest.fixture(scope="module")
def large_frames():
    """Frames that are scaled down and cut before the network sees them."""
    return list(SyntheticDrive(3, frames=2, image_size=(320, 180)))


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
    assert all(same_bits(a, b) for a, b in zip(answers, drive(pipeline, frames[:4]), strict=True))


def largest_move(one, other):
    """The largest difference of any number of any box or score of the same query and class."""
    rows = [
        dict(zip(zip(d.queries, d.classes, strict=True), np.column_stack([d.boxes, d.scores]), strict=True))
        for d in (one, other)
    ]
    common = rows[0].keys() & rows[1].keys()
    assert len(common) >= 299  # the last ones of equal score may change places at the cut
    off = np.array([rows[0][key] - rows[1][key] for key in common], dtype=np.float64)
    off[:, 6] = np.angle(np.exp(1j * off[:, 6]))
    return np.abs(off).max()


def test_where_on_earth_it_is_does_not_matter(pipeline, frames):
    """float64 numbers near 5e6 m lie 1e-9 m apart, so that poses lose nothing that could be seen."""
    offset = np.zeros((4, 4))
    offset[:3, 3] = 5e6
    far = [replace(frame, global_T_ego=frame.global_T_ego + offset) for frame in frames]
    answers = zip(drive(pipeline, far), drive(pipeline, frames), strict=True)
    assert max(largest_move(a, b) for a, b in answers) < 1e-4


def test_when_it_is_does_not_matter(pipeline, frames):
    """float64 stamps near 2.5e9 s lie 5e-7 s apart: at 100 m/s that is 5e-5 m, still below the bound."""
    late = [replace(frame, timestamp_s=frame.timestamp_s + 1e9) for frame in frames]
    answers = zip(drive(pipeline, late), drive(pipeline, frames), strict=True)
    assert max(largest_move(a, b) for a, b in answers) < 1e-4


class Spy:
    """A session that notes where the tensors of its last run lie, and may spoil its outputs."""

    def __init__(self, session, spoil=dict):
        self._session, self.spoil = session, spoil
        self.inputs, self.outputs, self.num_runs = {}, {}, 0

    def run(self, inputs):
        outputs = self.spoil(self._session.run(inputs))
        self.num_runs += 1
        self.inputs, self.outputs = (
            {name: value.data_ptr() for name, value in tensors.items()} for tensors in (inputs, outputs)
        )
        return outputs


def spied_on(pipeline, **spoil):
    spies = {name: Spy(session, spoil.get(name, dict)) for name, session in pipeline.sessions.items()}
    return Pipeline(pipeline.manifest, spies), spies


def test_what_frames_left_in_memory_is_bound_where_it_lies(pipeline, frames):
    watched, spies = spied_on(pipeline)
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
    watched, spies = spied_on(pipeline)
    drive(watched, [frames[0], frames[1], turned_rig(frames[2]), turned_rig(frames[3])])
    runs = {name: spy.num_runs for name, spy in spies.items()}
    assert runs == {"projector": 2, "backbone": 4, "lifter": 4, "decoder": 4, "segmenter": 0}


def test_a_camera_that_is_lost_and_returns_asks_for_new_tables(pipeline, frames):
    watched, spies = spied_on(pipeline)
    drive(watched, [frames[0], lose(frames[1], "CAM_FRONT"), lose(frames[2], "CAM_FRONT"), frames[3]])
    assert spies["projector"].num_runs == 3


def test_numbers_that_are_not_finite_are_dropped_and_counted(pipeline, frames):
    def spoil(outputs):
        logits, boxes = outputs["class_logits"].numpy().copy(), outputs["boxes"].numpy().copy()
        logits[3, 0], logits[5, 1], boxes[7, 8] = np.nan, np.inf, -np.inf
        return tensors(class_logits=logits, boxes=boxes)

    sick, _ = spied_on(pipeline, decoder=spoil)
    (answer,), (healthy,) = drive(sick, frames[:1]), drive(pipeline, frames[:1])
    assert (answer.dropped, answer.degraded) == (3, True)
    assert not set(answer.queries.tolist()) & {3, 5, 7}
    assert np.isfinite(answer.boxes).all()
    assert np.isfinite(answer.scores).all()
    rest = ~np.isin(healthy.queries, [3, 5, 7])
    assert np.array_equal(answer.boxes[: rest.sum()], healthy.boxes[rest])
    assert (healthy.dropped, healthy.degraded) == (0, False)


def test_a_frame_that_gives_nothing_finite_gives_no_detections(pipeline, frames):
    def spoil(outputs):
        return {name: tensors(x=np.full(value.shape(), np.nan, np.float32))["x"] for name, value in outputs.items()}

    sick, _ = spied_on(pipeline, decoder=spoil)
    (answer,) = drive(sick, frames[:1])
    assert len(answer) == len(answer.classes) == 0
    assert answer.dropped == 32
    assert answer.boxes.shape == (0, 9)


@pytest.mark.parametrize("graph", ["backbone", "lifter", "decoder"])
def test_a_step_that_breaks_off_changes_nothing(pipeline, frames, graph):
    def break_off(outputs):
        raise KeyboardInterrupt

    watched, spies = spied_on(pipeline)
    stream, expected = watched.stream(), drive(pipeline, frames[:4])
    for frame in frames[:3]:
        stream.step(frame)
    spies[graph].spoil = break_off
    with pytest.raises(KeyboardInterrupt):
        stream.step(turned_rig(frames[3]))
    spies[graph].spoil = dict
    assert same_bits(stream.step(frames[3]), expected[3])


def test_a_step_leaves_its_frame_as_it_is(pipeline, frames):
    copies = {name: image.copy() for name, image in frames[0].images.items()}
    drive(pipeline, frames[:2])
    assert all(np.array_equal(frames[0].images[name], copies[name]) for name in copies)


def test_detections_say_which_frame_they_are_of(pipeline, frames):
    answer = drive(pipeline, [replace(frames[0], token="t0", scene="s")])[0]
    assert (answer.scene, answer.token, answer.timestamp_s) == ("s", "t0", frames[0].timestamp_s)
    assert answer.maps == {}
    assert set(answer.timings_s) == {"preprocess", "projector", "backbone", "lifter", "decoder", "postprocess"}
    assert list(answer.scores) == sorted(answer.scores, reverse=True)


@pytest.mark.skipif(not is_here(), reason="the nuScenes frames do not lie beside this checkout")
def test_real_frames_pass_from_a_scene_folder(pipeline, tmp_path):
    answers = drive(pipeline, SceneFolder(write_scene_folder(tmp_path / "real")), maps=True)
    assert [answer.history.frames for answer in answers] == [1, 2, 3, 4]
    assert [answer.history.reset_reason for answer in answers] == [None] * 4
    for answer in answers:
        assert len(answer) == 320
        assert answer.dropped == 0
        assert np.isfinite(answer.boxes).all()
        assert all(np.isfinite(mask).all() for mask in answer.maps.values())


def test_where_the_ego_stands_changes_nothing_in_a_single_frame(pipeline, frames):
    """A pose that is rigid but for rounding must not scale the boxes of a cold start."""
    pose = frames[0].global_T_ego.copy()
    pose[:3, :3] *= 1 + 4.5e-4
    rounded = replace(frames[0], global_T_ego=pose)
    assert same_bits(pipeline.stream().step(rounded), pipeline.stream().step(frames[0]))


def test_map_cells_that_are_not_finite_are_zero_and_counted(pipeline, frames):
    class Broken:
        def run(self, features):
            masks = pipeline.sessions["segmenter"].run(features)
            spoilt = {name: mask.numpy().copy() for name, mask in masks.items()}
            spoilt["drivable_area"][0, 0, 3, 4] = np.nan
            return tensors(**spoilt)

    broken = Pipeline(pipeline.manifest, {**pipeline.sessions, "segmenter": Broken()})
    answer = broken.stream(maps=True).step(frames[0])
    assert (answer.dropped_cells, answer.degraded) == (1, True)
    assert answer.maps["drivable_area"][3, 4] == 0
    assert np.isfinite(answer.maps["drivable_area"]).all()
