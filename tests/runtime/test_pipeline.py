from dataclasses import replace

import numpy as np
import pytest

from duospacenet.data.scene_folder import SceneFolder
from duospacenet.runtime import Pipeline
from examples.nuscenes_scene import has_data, write_scene_folder
from tests.helpers.bundles import edit_graph, edit_manifest
from tests.helpers.older_schemas import downgrade
from tests.helpers.streams import bitwise_equal, detect_all, lose_cameras, record_sessions, turn_cameras

NUM_FRAMES = 4


def test_repeated_streams_over_the_same_frames_are_bitwise_equal(pipeline, frames):
    first = detect_all(pipeline, frames, maps=True)
    for _ in range(3):
        assert all(bitwise_equal(a, b) for a, b in zip(first, detect_all(pipeline, frames, maps=True), strict=True))


def test_the_caller_may_change_its_arrays_after_a_step(pipeline, frames):
    stream, results = pipeline.stream(), []
    for frame in frames[:4]:
        copied = replace(
            frame,
            images={name: image.copy() for name, image in frame.images.items()},
            cameras={
                name: replace(c, intrinsics_px=c.intrinsics_px.copy(), camera_T_ego=c.camera_T_ego.copy())
                for name, c in frame.cameras.items()
            },
            global_T_ego=frame.global_T_ego.copy(),
        )
        results.append(stream.step(copied))
        copied.global_T_ego[:] = np.nan
        for name, camera in copied.cameras.items():
            copied.images[name][:] = 0
            camera.intrinsics_px[:] = np.nan
            camera.camera_T_ego[:] = np.nan
    assert all(bitwise_equal(a, b) for a, b in zip(results, detect_all(pipeline, frames[:4]), strict=True))


def test_cached_values_are_passed_to_the_decoder_without_a_copy(pipeline, frames):
    recorded, recorders = record_sessions(pipeline)
    stream, cached = recorded.stream(), []
    empty = {name: value.data_ptr() for name, value in recorded.empty_memory.items()}
    for frame in frames:
        stream.step(frame)
        cached.insert(0, recorders["backbone"].outputs | recorders["lifter"].outputs)
        for t in range(NUM_FRAMES):
            expected = cached[t] if t < len(cached) else empty
            for name in pipeline.manifest.memory:
                assert recorders["decoder"].inputs[f"slot{t}.{name}"] == expected[name]


def test_each_graph_runs_once_per_frame_and_the_projector_only_after_a_calibration_change(pipeline, frames):
    recorded, recorders = record_sessions(pipeline)
    detect_all(recorded, [frames[0], frames[1], turn_cameras(frames[2]), turn_cameras(frames[3])])
    runs = {name: recorder.num_runs for name, recorder in recorders.items()}
    assert runs == {"projector": 2, "backbone": 4, "lifter": 4, "decoder": 4, "segmenter": 0}


def test_a_camera_that_is_lost_and_returns_runs_the_projector_again(pipeline, frames):
    recorded, recorders = record_sessions(pipeline)
    detect_all(
        recorded, [frames[0], lose_cameras(frames[1], "CAM_FRONT"), lose_cameras(frames[2], "CAM_FRONT"), frames[3]]
    )
    assert recorders["projector"].num_runs == 3


@pytest.mark.parametrize("graph", ["backbone", "lifter", "decoder"])
def test_an_interrupted_step_does_not_change_the_history(pipeline, frames, graph):
    def interrupt(outputs):
        raise KeyboardInterrupt

    recorded, recorders = record_sessions(pipeline)
    stream, expected = recorded.stream(), detect_all(pipeline, frames[:4])
    for frame in frames[:3]:
        stream.step(frame)
    recorders[graph].change_outputs = interrupt
    with pytest.raises(KeyboardInterrupt):
        stream.step(turn_cameras(frames[3]))
    recorders[graph].change_outputs = dict
    assert bitwise_equal(stream.step(frames[3]), expected[3])


def test_a_step_does_not_change_the_images_of_its_frame(pipeline, frames):
    copies = {name: image.copy() for name, image in frames[0].images.items()}
    detect_all(pipeline, frames[:2])
    assert all(np.array_equal(frames[0].images[name], copies[name]) for name in copies)


def test_detections_carry_scene_token_time_and_timings(pipeline, frames):
    result = detect_all(pipeline, [replace(frames[0], token="t0", scene="s")])[0]
    assert (result.scene, result.token, result.timestamp_s) == ("s", "t0", frames[0].timestamp_s)
    assert result.maps == {}
    assert set(result.timings_s) == {"preprocess", "projector", "backbone", "lifter", "decoder", "postprocess"}
    assert list(result.scores) == sorted(result.scores, reverse=True)


def test_maps_of_single_frames_equal_those_of_a_stream_with_maps_and_change_nothing_else(pipeline, frames):
    with_maps, stream = detect_all(pipeline, frames[:4], maps=True), pipeline.stream()
    results = [stream.step(frame, maps=index % 2 == 1) for index, frame in enumerate(frames[:4])]
    assert [list(result.maps) for result in results] == [[], list(with_maps[1].maps)] * 2
    expected = [replace(result, maps=result.maps if index % 2 else {}) for index, result in enumerate(with_maps)]
    assert all(bitwise_equal(a, b) for a, b in zip(results, expected, strict=True))


@pytest.mark.skipif(not has_data(), reason="the nuScenes frames are not beside this checkout")
def test_real_frames_of_a_scene_folder_are_processed(pipeline, tmp_path):
    results = detect_all(pipeline, SceneFolder(write_scene_folder(tmp_path / "real")), maps=True)
    assert [result.history.frames for result in results] == [1, 2, 3, 4]
    assert [result.history.reset_reason for result in results] == [None] * 4
    for result in results:
        assert len(result) == 320
        assert result.dropped_queries == 0
        assert np.isfinite(result.boxes).all()
        assert all(np.isfinite(mask).all() for mask in result.maps.values())


def test_a_pose_with_rounding_errors_does_not_change_a_single_frame(pipeline, frames):
    """A rotation that is orthonormal up to rounding must not scale the boxes of the first frame."""
    pose = frames[0].global_T_ego.copy()
    pose[:3, :3] *= 1 + 4.5e-4
    rounded = replace(frames[0], global_T_ego=pose)
    assert bitwise_equal(pipeline.stream().step(rounded), pipeline.stream().step(frames[0]))


OLD_NAMES = {
    **{f"reduced_pv_{level}": f"pv_{level}" for level in range(4)},
    "voxel_locations": "sampling_grid",
    "voxel_visible": "voxel_weight",
}


def test_a_bundle_of_schema_3_with_other_names_between_its_graphs_gives_the_same_detections(
    copied_bundle, pipeline, frames
):
    """Before schema 4, the tensors between backbone, projector and lifter had other names."""
    for graph in ("backbone", "projector", "lifter"):
        edit_graph(copied_bundle, graph, rename_tensors)

    def to_schema_3(manifest):
        downgrade(manifest, 3)
        for graph in manifest["graphs"].values():
            for tensor in (*graph["inputs"], *graph["outputs"]):
                tensor["name"] = OLD_NAMES.get(tensor["name"], tensor["name"])

    edit_manifest(copied_bundle, to_schema_3)
    old = Pipeline.load(copied_bundle)
    assert old.manifest.attention == "grid-sample"
    drive = [frames[0], lose_cameras(frames[1], "CAM_BACK"), *frames[2:4]]
    results = zip(detect_all(old, drive, maps=True), detect_all(pipeline, drive, maps=True), strict=True)
    assert all(bitwise_equal(one, other) for one, other in results)


def rename_tensors(model):
    for node in model.graph.node:
        node.input[:] = [OLD_NAMES.get(name, name) for name in node.input]
        node.output[:] = [OLD_NAMES.get(name, name) for name in node.output]
    for value in (*model.graph.input, *model.graph.output):
        value.name = OLD_NAMES.get(value.name, value.name)
