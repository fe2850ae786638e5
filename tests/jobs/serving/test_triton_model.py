"""The model that Triton runs, with a fake of Triton in this process. `test_triton_server` uses a real one."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from duospacenet.jobs.serving import frame_request
from duospacenet.jobs.serving.serving_options import ServingOptions
from duospacenet.jobs.serving.triton_model import TritonModel
from duospacenet.jobs.serving.triton_repository import MODEL_CODE
from duospacenet.runtime import Pipeline
from duospacenet.runtime.errors import ArtifactError
from tests.helpers.consumer_drive import consumer_drive
from tests.helpers.fake_triton import (
    OUTPUTS,
    FakeModelException,
    FakeServer,
    FakeTensor,
    fake_utils,
    model_config,
    request_inputs,
)
from tests.helpers.streams import TINY_SIZE_PX, lose_cameras


@pytest.fixture
def server(tiny_bundle, tmp_path) -> FakeServer:
    return FakeServer(tiny_bundle, tmp_path / "model", ServingOptions(vehicles=2, idle_s=10.0))


def expected_outputs(pipeline: Pipeline, frames, maps=True) -> list[dict[str, list]]:
    """The outputs of a stream in this process, as the docs describe them."""
    stream, manifest = pipeline.stream(maps=maps), pipeline.manifest
    outputs = []
    for frame in frames:
        detections = stream.step(frame)
        outputs.append(
            {
                "boxes": detections.boxes.tolist(),
                "scores": detections.scores.tolist(),
                "class_ids": [manifest.classes.index(name) for name in detections.classes],
                "attributes": [name.encode() for name in detections.attributes],
                "history_frames": [detections.history.frames],
                "reset_reason": [(detections.history.reset_reason or "").encode()],
                "skipped": [(detections.skipped or "").encode()],
                "dropped": [0, 0],
                "maps": [detections.maps[name].tolist() for name in manifest.map_classes if detections.maps],
            }
        )
    return outputs


def as_lists(outputs: list[dict[str, np.ndarray]]) -> list[dict[str, list]]:
    return [{name: array.tolist() for name, array in frame.items()} for frame in outputs]


def test_two_interleaved_vehicles_equal_two_streams(server, pipeline, frames, other_frames):
    results = {"a": [], 7: []}
    for index in range(6):
        for sequence, drive in (("a", frames), (7, other_frames)):
            results[sequence].append(server.send(drive[index], sequence, index == 0, index == 5).arrays())
    assert as_lists(results["a"]) == expected_outputs(pipeline, frames)
    assert as_lists(results[7]) == expected_outputs(pipeline, other_frames)
    assert server.model.num_sequences == 0


def test_lost_and_absent_cameras_new_scenes_gaps_and_skipped_frames_are_as_in_a_stream(server, pipeline):
    drive = consumer_drive(TINY_SIZE_PX)
    assert as_lists(server.drive(drive, "a")) == expected_outputs(pipeline, drive)


def test_outputs_have_the_declared_types(server, frames):
    arrays = server.send(frames[0], "a", start=True).arrays()
    types = {name: array.dtype for name, array in arrays.items()}
    texts = {"attributes", "reset_reason", "skipped"}
    integers = {"class_ids", "history_frames", "dropped"}
    assert types == {
        name: np.dtype(object if name in texts else np.int32 if name in integers else np.float32) for name in OUTPUTS
    }
    assert (arrays["boxes"].shape, arrays["maps"].shape) == ((320, 9), (2, 16, 16))
    skipped = server.send(lose_cameras(frames[1], *frames[1].cameras), "a").arrays()
    assert (skipped["boxes"].shape, skipped["maps"].shape) == ((0, 9), (0, 16, 16))
    assert skipped["skipped"].tolist() == [b"every camera is lost"]


def test_only_the_requested_outputs_are_computed(server, frames, monkeypatch):
    sessions = server.model._pipeline.sessions
    monkeypatch.setattr(server.model._pipeline, "sessions", {n: s for n, s in sessions.items() if n != "segmenter"})
    assert set(server.send(frames[0], "a", start=True, outputs=["scores"]).arrays()) == {"scores"}
    assert "maps: expected a bundle with map classes" in server.send(frames[1], "a", outputs=["maps"]).refusal()


def without(inputs, name):
    return {key: array for key, array in inputs.items() if key != name}


BAD_INPUTS = {
    "an image that is cut off": (lambda i: {"images": np.array([d[:99] for d in i["images"]], object)}, "CAM_FRONT"),
    "text instead of an image": (lambda i: {"images": np.array([b"no image"] * 6, object)}, "expected a JPEG or PNG"),
    "an image of another size": (lambda i: {"size_px": i["size_px"] + 1}, "expected 161x65 px"),
    "one image too few": (lambda i: {"images": i["images"][:5]}, "images: expected 6 rows"),
    "one size too many": (lambda i: {"size_px": np.tile(i["size_px"], (2, 1))}, "size_px: expected 6 rows"),
    "two cameras of one name": (lambda i: {"camera_names": i["camera_names"][[0, 0, 2, 3, 4, 5]]}, "different names"),
    "a name that is not UTF-8": (
        lambda i: {"camera_names": np.array([b"\xff", *i["camera_names"][1:]], object)},
        "camera_names: expected text in UTF-8",
    ),
    "a name with an escape": (
        lambda i: {"camera_names": np.array([b"\x1b[2J", *i["camera_names"][1:]], object)},
        "camera_names: expected text without control characters",
    ),
    "a scene with a line end": (lambda i: {"scene": np.array([b"a\nb"], object)}, "scene: expected text without"),
    "no cameras": (lambda i: {name: array[:0] for name, array in i.items() if len(array) == 6}, "expected 1 to 6"),
    "seven cameras": (
        lambda i: {
            name: np.array([*array, b"seventh" if name == "camera_names" else array[0]], array.dtype)
            for name, array in i.items()
            if len(array) == 6
        },
        "camera_names: expected 1 to 6 cameras; got 7",
    ),
    "a pose with NaN": (lambda i: {"global_T_ego": np.full((4, 4), np.nan)}, "global_T_ego"),
    "intrinsics of zeros": (lambda i: {"intrinsics_px": np.zeros((6, 3, 3))}, "intrinsics_px"),
    "an infinite time": (lambda i: {"timestamp_s": np.array([np.inf])}, "timestamp_s"),
    "sizes below zero": (lambda i: {"size_px": -i["size_px"]}, "CAM_FRONT"),
}


@pytest.mark.parametrize("kind", BAD_INPUTS)
def test_a_bad_frame_is_refused_and_the_next_frame_is_as_without_it(server, pipeline, frames, kind):
    change, message = BAD_INPUTS[kind]
    first = server.send(frames[0], "a", start=True).arrays()
    inputs = request_inputs(frames[1])
    refusal = server.send(inputs | change(inputs), "a").refusal()
    assert message in refusal
    assert refusal.isprintable()
    results = [first, server.send(frames[1], "a").arrays()]
    assert as_lists(results) == expected_outputs(pipeline, frames[:2])


def test_nothing_is_decoded_before_the_rest_is_checked(server, frames, monkeypatch):
    monkeypatch.setattr(frame_request, "decode_image", lambda *arguments: pytest.fail("an image was decoded"))
    inputs = request_inputs(frames[0]) | {"camera_T_ego": np.zeros((6, 4, 4))}
    assert "camera_T_ego" in server.send(inputs, "a", start=True).refusal()


def test_a_duplicate_and_an_older_frame_are_refused(server, pipeline, frames):
    results = [server.send(frame, "a", start=index == 0).arrays() for index, frame in enumerate(frames[:3])]
    for frame in (frames[2], frames[0]):
        assert "timestamp_s: expected later" in server.send(frame, "a").refusal()
    results.append(server.send(frames[3], "a", end=True).arrays())
    assert as_lists(results) == expected_outputs(pipeline, frames[:4])


def test_without_a_scene_a_sequence_is_one_scene(server, pipeline, frames):
    results = [
        server.send(without(request_inputs(frame), "scene"), "a", index == 0).arrays()
        for index, frame in enumerate(frames[:3])
    ]
    expected = expected_outputs(pipeline, [replace(frame, scene="") for frame in frames[:3]])
    assert as_lists(results) == expected


def test_a_frame_without_a_start_is_refused(server, frames):
    assert "Send the frame again with the start flag" in server.send(frames[0], "a").refusal()
    assert server.model.num_sequences == 0


def test_a_bad_first_frame_starts_the_sequence_and_a_bad_last_one_ends_it(server, pipeline, frames):
    bad = request_inputs(frames[0]) | {"timestamp_s": np.array([np.nan])}
    server.send(bad, "a", start=True).refusal()
    assert as_lists([server.send(frames[0], "a").arrays()]) == expected_outputs(pipeline, frames[:1])
    server.send(bad, "a", end=True).refusal()
    assert server.model.num_sequences == 0


def test_a_sequence_that_was_lost_restarts_cold(server, pipeline, frames, other_frames):
    server.send(frames[0], "lost", start=True)
    server.send(other_frames[0], "b", start=True)
    server.send(other_frames[0], "c", start=True)  # of two places, this takes that of `lost`
    server.send(frames[1], "lost").refusal()
    assert as_lists(server.drive(frames[1:4], "lost")) == expected_outputs(pipeline, frames[1:4])
    assert server.model.num_sequences == 1


def test_a_graph_that_fails_is_an_error_of_the_server(server, frames, monkeypatch):
    def fail(tensors):
        raise ArtifactError("the graph failed to run")

    monkeypatch.setattr(server.model._pipeline.sessions["decoder"], "run", fail)
    error = server.send(frames[0], "a", start=True).error()
    assert (error.code(), error.message()) == (1, "the graph failed to run")


def test_a_bug_fails_one_request_and_the_next_frame_is_as_without_it(server, pipeline, frames, monkeypatch):
    outputs = [server.send(frames[0], "a", start=True).arrays()]
    with monkeypatch.context() as patch:
        patch.setattr(frame_request, "decode_image", lambda *arguments: {}["missing"])
        error = server.send(frames[1], "a").error()
    assert (error.code(), error.message()) == (1, "internal error: KeyError: 'missing'")
    outputs.append(server.send(frames[1], "a").arrays())
    assert as_lists(outputs) == expected_outputs(pipeline, frames[:2])


class SameElements(FakeTensor):
    """A tensor as the backend before Triton 24.12 gives it with numpy 2: all elements are the first one."""

    @classmethod
    def from_dlpack(cls, name, tensor):
        array = tensor.as_numpy()
        return cls(name, np.full_like(array, array.flat[0]))


def test_a_backend_that_does_not_support_numpy_2_is_refused_when_the_server_starts():
    with pytest.raises(FakeModelException, match=r"Use Triton 24\.12 or later, or numpy below 2"):
        TritonModel(fake_utils(SameElements), {"model_config": "{}", "model_repository": ".", "model_version": "1"})


def test_a_damaged_bundle_is_refused_when_the_server_starts(copied_bundle, tmp_path):
    (copied_bundle / "decoder.onnx").write_bytes(b"damaged")
    with pytest.raises(FakeModelException, match=r"decoder\.onnx: field graphs\.decoder\.sha256"):
        FakeServer(copied_bundle, tmp_path / "model")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("on_missing", "stop", "on_missing"),
        ("history_step_s", "99", "history step"),
        ("history_step_s", "fast", "parameter history_step_s: expected a number or nothing; got 'fast'"),
        ("threads", "1.5", "parameter threads: expected a number"),
        ("threads", "0", "threads: expected 1 to 1024"),
    ],
)
def test_an_edited_setting_is_refused_when_the_server_starts(tiny_bundle, tmp_path, name, value, message):
    parameters = model_config(ServingOptions())["parameters"]
    with pytest.raises(FakeModelException, match=message):
        FakeServer(tiny_bundle, tmp_path / "model", parameters=parameters | {name: {"string_value": value}})


def test_another_strategy_of_the_scheduler_is_refused_when_the_server_starts(tiny_bundle, tmp_path):
    with pytest.raises(FakeModelException, match="expected the strategy oldest"):
        FakeServer(tiny_bundle, tmp_path / "model", sequence_batching={"direct": {}})


def test_the_settings_of_the_streams_are_those_of_the_configuration(tiny_bundle, tmp_path, pipeline, frames):
    server = FakeServer(tiny_bundle, tmp_path / "model", ServingOptions(on_missing="error"))
    assert "got a lost camera" in server.send(lose_cameras(frames[0], "CAM_FRONT"), "a", start=True).refusal()


def test_the_model_file_of_a_repository_passes_triton_s_module_on(tiny_bundle, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "triton_python_backend_utils", fake_utils())
    FakeServer(tiny_bundle, tmp_path / "model")  # only for its folder
    namespace: dict = {}
    exec(compile(MODEL_CODE, "model.py", "exec"), namespace)
    model = namespace["TritonPythonModel"]()
    config = json.dumps(model_config(ServingOptions()))
    model.initialize({"model_config": config, "model_repository": str(tmp_path / "model"), "model_version": "1"})
    assert model.execute([]) == []
