import json
import os
import subprocess
import sys

import numpy as np
import pytest

from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.errors import ArtifactError, UsageError
from duospacenet.runtime.onnxruntime_session import OnnxruntimeSession
from duospacenet.runtime.session import to_tensors
from tests.helpers.bundles import edit_graph, edit_manifest, update_graph_hash


def run_python(code):
    """Run the code in a new process and return its output."""
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    return process.stdout.strip()


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="no affinity on this system")
def test_a_process_bound_to_one_core_has_one_available_core():
    code = (
        "import os; os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})\n"
        "from duospacenet.runtime.cores import available_cores; print(available_cores())"
    )
    assert run_python(code) == "1"


def test_a_pool_of_another_size_is_refused_in_the_same_process(pipeline, tiny_bundle):
    threads = available_cores()
    message = f"expected {threads}, the size of this process's thread pool; got {threads + 1}"
    with pytest.raises(UsageError, match=message):
        Pipeline.load(tiny_bundle, threads=threads + 1)
    Pipeline.load(tiny_bundle, threads=threads)


@pytest.mark.parametrize("threads", [0, -1, 1025])
def test_a_pool_with_an_impossible_number_of_threads_is_refused(tiny_bundle, threads):
    with pytest.raises(UsageError, match=f"threads: expected 1 to 1024; got {threads}"):
        Pipeline.load(tiny_bundle, threads=threads)


def test_one_thread_gives_the_same_scores_as_several(pipeline, tiny_bundle, frames):
    code = (
        "import numpy as np\n"
        "from duospacenet.runtime import Pipeline\n"
        "from duospacenet.synthetic.drive import SyntheticDrive\n"
        f"stream = Pipeline.load({str(tiny_bundle)!r}, threads=1).stream()\n"
        "for frame in SyntheticDrive(1, frames=3, image_size=(160, 64)):\n"
        "    scores = stream.step(frame).scores\n"
        "print(scores.astype(float).tolist())"
    )
    stream = pipeline.stream()
    for frame in frames[:3]:
        scores = stream.step(frame).scores
    np.testing.assert_allclose(json.loads(run_python(code)), scores, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda graph: graph["inputs"][0].update(shape=[6, 32, 160, 3]), "inputs: .*'images', .*32.* the graph has"),
        (lambda graph: graph["inputs"][0].update(dtype="float32"), "inputs: .*'float32'.* the graph has .*'uint8'"),
        (lambda graph: graph["inputs"][0].update(name="pictures"), "inputs: .*'pictures'.* the graph has .*'images'"),
        (lambda graph: graph["outputs"][1].update(shape=[1]), "outputs: .*'reduced_pv_1'"),
        (lambda graph: graph["outputs"].reverse(), "outputs: "),
        (lambda graph: graph["outputs"].pop(), r"outputs: manifest\.json lists \d+; the graph has \d+"),
        (lambda graph: graph["inputs"].append(graph["inputs"][0]), "inputs: .* lists 2; the graph has 1"),
    ],
)
def test_a_manifest_with_other_tensors_than_the_graph_is_refused(copied_bundle, change, message):
    edit_manifest(copied_bundle, lambda manifest: change(manifest["graphs"]["backbone"]))
    with pytest.raises(ArtifactError, match=rf"backbone\.onnx: {message}"):
        Pipeline.load(copied_bundle)


@pytest.mark.parametrize("content", [b"", b"\x08\x07garbage", b"\x80\x02}q\x00."])
def test_a_file_that_is_not_a_graph_is_refused(copied_bundle, content):
    path = copied_bundle / "lifter.onnx"
    path.write_bytes(content)
    update_graph_hash(copied_bundle, "lifter")
    with pytest.raises(ArtifactError, match=r"lifter\.onnx: expected an ONNX file"):
        Pipeline.load(copied_bundle)


def test_a_graph_that_onnxruntime_cannot_read_is_refused(copied_bundle):
    edit_graph(copied_bundle, "lifter", lambda model: model.graph.node[0].input.append("nowhere"))
    with pytest.raises(ArtifactError, match=r"lifter\.onnx: onnxruntime refuses the graph"):
        Pipeline.load(copied_bundle)


def test_a_session_takes_its_inputs_by_name_and_does_not_change_them(pipeline, tiny_bundle):
    spec = read_manifest(tiny_bundle).graphs["segmenter"]
    session = OnnxruntimeSession((tiny_bundle / spec.file).read_bytes(), spec, tiny_bundle / spec.file)
    bev = np.random.default_rng(0).normal(size=spec.inputs[0].shape).astype(np.float32)
    inputs = to_tensors(other=np.zeros(3, np.float32), bev=bev.copy())
    first, second = session.run(inputs), session.run(inputs)
    assert list(first) == ["drivable_area", "lane_boundary"]
    assert np.array_equal(inputs["bev"].numpy(), bev)
    for name, mask in first.items():
        assert mask.data_ptr() != second[name].data_ptr()
        assert np.array_equal(mask.numpy(), second[name].numpy())


def test_a_file_that_is_exchanged_after_its_check_is_not_read(pipeline, copied_bundle, frames, monkeypatch):
    """onnxruntime gets the bytes that were checked."""

    def exchange_files(_threads):
        for path in copied_bundle.glob("*.onnx"):
            path.write_bytes(b"exchanged")

    monkeypatch.setattr("duospacenet.runtime.engine.set_thread_pool_size", exchange_files)
    exchanged = Pipeline.load(copied_bundle)
    assert (copied_bundle / "decoder.onnx").read_bytes() == b"exchanged"
    expected, got = pipeline.stream().step(frames[0]), exchanged.stream().step(frames[0])
    assert np.array_equal(expected.boxes, got.boxes)
    assert np.array_equal(expected.scores, got.scores)


def test_a_session_does_not_keep_the_bytes_of_its_file(pipeline, tiny_bundle):
    spec = read_manifest(tiny_bundle).graphs["segmenter"]
    content = (tiny_bundle / spec.file).read_bytes()
    before = sys.getrefcount(content)
    session = OnnxruntimeSession(content, spec, tiny_bundle / spec.file)
    assert sys.getrefcount(content) == before
    assert session


def test_a_graph_that_onnxruntime_refuses_leaves_stdout_empty(copied_bundle, capfd):
    """onnxruntime's Python module would print about a fallback on stdout, where only results belong."""
    edit_graph(copied_bundle, "lifter", lambda model: model.graph.node[0].input.append("nowhere"))
    with pytest.raises(ArtifactError, match=r"lifter\.onnx: onnxruntime refuses the graph"):
        Pipeline.load(copied_bundle)
    assert capfd.readouterr() == ("", "")
