"""OpenVINO as an engine. Equality with PyTorch on every graph is tested in tests/cli/test_parity.py."""

import threading
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper

from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import GraphSpec, TensorSpec, read_manifest
from duospacenet.runtime.errors import ArtifactError, UsageError
from duospacenet.runtime.openvino_session import OpenvinoSession
from duospacenet.runtime.session import to_tensors
from duospacenet.runtime.termination import terminate_calls
from tests.helpers.bundles import edit_graph, edit_manifest
from tests.helpers.slow_graphs import slow_graph
from tests.helpers.streams import bitwise_equal, detect_all, record_sessions

open_session = partial(OpenvinoSession, threads=2, precision="f32")


@pytest.fixture(scope="module")
def openvino_pipeline(portable_bundle) -> Pipeline:
    return Pipeline.load(portable_bundle, engine="openvino")


@pytest.fixture(scope="module")
def onnxruntime_pipeline(portable_bundle) -> Pipeline:
    return Pipeline.load(portable_bundle)


@pytest.fixture
def segmenter(portable_bundle) -> tuple[OpenvinoSession, np.ndarray]:
    """A session, and an input for it."""
    spec = read_manifest(portable_bundle).graphs["segmenter"]
    path = portable_bundle / spec.file
    bev = np.random.default_rng(0).normal(size=spec.inputs[0].shape).astype(np.float32)
    return open_session(path.read_bytes(), spec, path), bev


# --- results ------------------------------------------------------------------------------------------------------


def test_a_stream_has_the_boxes_of_onnxruntime_with_windows_of_one_to_four_frames(
    openvino_pipeline, onnxruntime_pipeline, frames
):
    actual, expected = (detect_all(p, frames, maps=True) for p in (openvino_pipeline, onnxruntime_pipeline))
    assert [detections.history.frames for detections in actual] == [1, 2, 3, 4, 4, 4]
    for got, want in zip(actual, expected, strict=True):
        scores, wanted_scores = _score_by_detection(got), _score_by_detection(want)
        assert scores.keys() == wanted_scores.keys()
        np.testing.assert_allclose(list(scores.values()), [wanted_scores[key] for key in scores], atol=1e-5)
        for name, mask in want.maps.items():
            np.testing.assert_allclose(got.maps[name], mask, atol=1e-5)


def _score_by_detection(detections):
    return dict(zip(zip(detections.queries, detections.classes, strict=True), detections.scores, strict=True))


def test_two_interleaved_streams_have_the_same_bits_as_each_alone(openvino_pipeline, frames, other_frames):
    """Cached values of one stream stay when the graphs run for the other one."""
    one, other = openvino_pipeline.stream(), openvino_pipeline.stream()
    pairs = [(one.step(a), other.step(b)) for a, b in zip(frames, other_frames, strict=True)]
    alone = detect_all(openvino_pipeline, frames), detect_all(openvino_pipeline, other_frames)
    for pair, expected in zip(pairs, zip(*alone, strict=True), strict=True):
        assert all(map(bitwise_equal, pair, expected))


def test_streams_in_several_threads_have_the_same_bits_as_one_after_the_other(openvino_pipeline, frames, other_frames):
    drives = [frames[:3], other_frames[:3]] * 2
    with ThreadPoolExecutor(len(drives)) as threads:
        parallel = list(threads.map(partial(detect_all, openvino_pipeline), drives))
    for results, drive in zip(parallel, drives, strict=True):
        assert all(map(bitwise_equal, results, detect_all(openvino_pipeline, drive)))


def test_cached_values_are_passed_to_the_decoder_without_a_copy(openvino_pipeline, frames):
    recorded, recorders = record_sessions(openvino_pipeline)
    stream = recorded.stream()
    stream.step(frames[0])
    cached = recorders["backbone"].outputs | recorders["lifter"].outputs
    stream.step(frames[1])
    for name in recorded.manifest.memory:
        assert recorders["decoder"].inputs[f"slot1.{name}"] == cached[name]


def test_a_run_leaves_its_inputs_and_the_outputs_of_earlier_runs_unchanged(segmenter):
    session, bev = segmenter
    inputs = to_tensors(other=np.zeros(3, np.float32), bev=bev.copy())
    first = session.run(inputs)
    kept = {name: mask.numpy().copy() for name, mask in first.items()}
    second = session.run(to_tensors(bev=-bev))
    assert list(first) == ["drivable_area", "lane_boundary"]
    assert np.array_equal(inputs["bev"].numpy(), bev)
    for name, mask in first.items():
        assert np.array_equal(mask.numpy(), kept[name])
        assert not np.array_equal(second[name].numpy(), kept[name])


def test_the_default_precision_is_openvinos_own_choice_and_is_reported(portable_bundle, openvino_pipeline):
    chosen = Pipeline.load(portable_bundle, engine="openvino", engine_precision="default").engine
    assert openvino_pipeline.engine["precision"] == "float32"
    has_bfloat16 = any(name in _cpu_flags() for name in ("avx512_bf16", "amx_bf16"))
    assert chosen["precision"] == ("bfloat16" if has_bfloat16 else "float32")


def _cpu_flags() -> set[str]:
    return set(Path("/proc/cpuinfo").read_text().partition("flags")[2].partition("\n")[0].split())


# --- refused graphs -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda graph: graph["inputs"][0].update(dtype="float32"), "inputs: .*'float32'.* the graph has .*'uint8'"),
        (lambda graph: graph["inputs"][0].update(name="pictures"), "inputs: .*'pictures'.* the graph has .*'images'"),
        (lambda graph: graph["outputs"][1].update(shape=[1]), r"outputs: manifest\.json says .*\(1,\)"),
        (lambda graph: graph["outputs"].pop(), r"outputs: manifest\.json lists \d+; the graph has \d+"),
        (lambda graph: graph["inputs"].append(graph["inputs"][0]), "inputs: .* lists 2; the graph has 1"),
    ],
)
def test_a_manifest_with_other_tensors_than_the_graph_is_refused(copied_portable_bundle, change, message):
    edit_manifest(copied_portable_bundle, lambda manifest: change(manifest["graphs"]["backbone"]))
    with pytest.raises(ArtifactError, match=rf"backbone\.onnx: {message}"):
        Pipeline.load(copied_portable_bundle, engine="openvino")


def test_a_changed_graph_file_is_refused(copied_portable_bundle):
    path = copied_portable_bundle / "lifter.onnx"
    path.write_bytes(path.read_bytes()[:-1] + b"\x00")
    with pytest.raises(ArtifactError, match=r"lifter\.onnx: field graphs\.lifter\.sha256"):
        Pipeline.load(copied_portable_bundle, engine="openvino")


def test_a_graph_that_openvino_cannot_read_is_refused_on_one_line_and_nothing_is_printed(copied_portable_bundle, capfd):
    edit_graph(copied_portable_bundle, "lifter", lambda model: model.graph.node[0].input.append("nowhere"))
    with pytest.raises(
        ArtifactError, match=r"lifter\.onnx: OpenVINO refuses the graph: nowhere .*not found"
    ) as refusal:
        Pipeline.load(copied_portable_bundle, engine="openvino")
    assert "\n" not in str(refusal.value)
    assert capfd.readouterr() == ("", "")


def test_a_graph_with_the_operator_deform_conv_is_refused_with_the_options_to_export_it(tmp_path):
    names, shape = ("x", "offset", "y"), (1, 2, 4, 4)
    tensors = {name: helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in names}
    weight = onnx.numpy_helper.from_array(np.ones((2, 1, 1, 1), np.float32), "weight")
    node = helper.make_node("DeformConv", ["x", "weight", "offset"], ["y"], group=2)
    graph = helper.make_graph([node], "g", [tensors["x"], tensors["offset"]], [tensors["y"]], [weight])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    specs = {name: TensorSpec(name=name, shape=shape, dtype="float32") for name in names}
    spec = GraphSpec(file="g.onnx", sha256="", inputs=(specs["x"], specs["offset"]), outputs=(specs["y"],))
    message = "expected the grid-sample form, .* no operator DeformConv; .* --dcn grid-sample"
    with pytest.raises(ArtifactError, match=message):
        open_session(model.SerializeToString(), spec, tmp_path / "g.onnx")


@pytest.mark.parametrize("threads", [0, -1, 1025])
def test_an_impossible_number_of_threads_is_refused(portable_bundle, threads):
    with pytest.raises(UsageError, match=f"threads: expected 1 to 1024; got {threads}"):
        Pipeline.load(portable_bundle, threads=threads, engine="openvino")


# --- interruption -------------------------------------------------------------------------------------------------


def test_a_run_in_another_thread_ends_early_and_the_session_can_run_again():
    session = open_session(*slow_graph("long chain", length=60))
    x = np.zeros((1024, 1024), np.float32)
    with ThreadPoolExecutor(1) as threads:
        run = threads.submit(session.run, to_tensors(x=x))
        while not run.done():
            terminate_calls()
            threading.Event().wait(0.05)
        with pytest.raises(KeyboardInterrupt):
            run.result()
    assert np.array_equal(session.run(to_tensors(x=x))["y"].numpy(), x)
