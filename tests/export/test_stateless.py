"""The stateless form of a model: one ONNX graph over the whole window, against `DuoSpaceNet.forward`."""

from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch

from duospacenet.export.stateless import INPUTS, StatelessModel, export_stateless
from duospacenet.jobs.benchmarking.stateless_runners import GraphNetwork, StatelessRunner
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime.cores import available_cores
from tests.helpers.streams import TINY_SIZE_PX, lose_cameras

SHORT = replace(PRESETS["tiny"], num_frames=2, num_layers=1)  # less than half of the graph with four frames


@pytest.fixture(scope="module")
def model() -> DuoSpaceNet:
    return randomise(DuoSpaceNet(SHORT), 3).eval()


@pytest.fixture(scope="module")
def graph(model, tmp_path_factory):
    """The path of the graph, and its description."""
    path = tmp_path_factory.mktemp("graphs") / "stateless.onnx"
    return path, export_stateless(model, path)


@pytest.fixture(scope="module")
def window(frames, pipeline) -> dict[str, np.ndarray]:
    """The network's inputs of a full window of two frames, the older with a lost camera."""
    assert frames[0].images["CAM_FRONT"].shape[1::-1] == TINY_SIZE_PX
    inputs = []
    manifest = pipeline.manifest
    manifest = manifest.model_copy(update={"window": manifest.window.model_copy(update={"num_frames": 2})})

    def record(network_inputs):
        inputs.append(network_inputs)
        return {"class_logits": np.zeros((32, 10), np.float32), "boxes": np.zeros((32, 9), np.float32)}

    runner = StatelessRunner(manifest, record)
    for frame in (lose_cameras(frames[0], "CAM_BACK"), frames[1]):
        runner.step(frame)
    assert inputs[1]["frame_valid"].all() and not inputs[0]["frame_valid"].all()
    return inputs[1]


def test_the_graph_equals_the_model(model, graph, window):
    path, spec = graph
    assert tuple(tensor.name for tensor in spec.inputs) == INPUTS
    with torch.inference_mode():
        output = model(*(torch.from_numpy(window[name]) for name in INPUTS))
        logits, boxes, *_ = StatelessModel(model)(*(torch.from_numpy(window[name]) for name in INPUTS))
    found = GraphNetwork(path, spec, available_cores(), "onnxruntime")(window)
    expected = {"class_logits": output.predictions[-1].class_logits, "boxes": boxes, **output.maps}
    assert torch.equal(logits, expected["class_logits"])
    assert set(found) == set(expected) == {"class_logits", "boxes", "drivable_area", "lane_boundary"}
    for name, tensor in expected.items():
        scale = float(tensor.square().mean().sqrt())
        assert np.abs(found[name] - tensor.numpy()).max() <= 1e-4 * scale, name


def test_every_input_matters(graph, window):
    """A graph with a frozen or ignored input would be another computation, and could be faster."""
    network = GraphNetwork(*graph, available_cores(), "onnxruntime")
    expected = network(window)["class_logits"]
    for name in INPUTS:
        changed = dict(window)
        is_switch = window[name].dtype == np.bool_
        # A common factor of a projection's three rows would have no effect.
        factor = np.array([[1.1], [1.1], [1.0]]) if name == "image_T_ego" else 1.1
        changed[name] = ~window[name] if is_switch else (window[name] * factor).astype(window[name].dtype)
        assert not np.allclose(network(changed)["class_logits"], expected, atol=1e-6), name


def test_the_graph_has_the_portable_form(graph):
    operators = {node.op_type for node in onnx.load(graph[0]).graph.node}
    assert "GridSample" in operators
    assert "DeformConv" not in operators
