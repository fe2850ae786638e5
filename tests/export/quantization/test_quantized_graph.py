"""Quantized graphs: their arithmetic by a loop in numpy, and what files of bundles may hold."""

import numpy as np
import onnx
import pytest

from duospacenet.export.quantization.blocks import blocks_of
from duospacenet.export.quantization.calibration import GraphCalibration
from duospacenet.export.quantization.quantized_graph import quantize_graph, recipe
from duospacenet.export.quantization.simulated_session import SimulatedSession
from duospacenet.runtime.bundle.graph_file import check_graph
from duospacenet.runtime.bundle.operators import DEFAULT_OPSET, OPSETS
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.onnxruntime_session import set_thread_pool_size
from duospacenet.runtime.session import to_tensors
from tests.helpers.small_graphs import FIRST, SECOND, convolve, small_inputs, small_weights, write_small_graph

BLOCKS = {"image_encoder.backbone.layer1", "image_encoder.neck"}


@pytest.fixture
def calibrated(tmp_path):
    """The small graph and its ranges on four inputs."""
    return calibrate(write_small_graph(tmp_path), tmp_path / "temporary")


def calibrate(graph, folder):
    set_thread_pool_size(available_cores())
    folder.mkdir()
    calibration = GraphCalibration(graph, folder)
    for inputs in small_inputs(1, 4):
        calibration.add(inputs)
    return graph, calibration.ranges()


def round_activation(values, low, high):
    """Rounding to uint8 with one scale and zero point, which represent 0 exactly."""
    low, high = min(low, 0.0), max(high, 0.0)
    scale = np.float32((high - low) / 255)
    zero_point = np.round(-low / scale)
    return (np.clip(np.round(values / scale) + zero_point, 0, 255) - zero_point) * float(scale)


def round_weight(weight):
    """Rounding to int8 with one scale per output channel."""
    scales = np.abs(weight).reshape(len(weight), -1).max(axis=1) / 127
    shape = (-1, 1, 1, 1)
    return np.round(weight / scales.reshape(shape)) * scales.reshape(shape)


def test_a_quantized_graph_rounds_weights_by_channel_and_activations_by_tensor(calibrated):
    graph, ranges = calibrated
    weights, runs = small_weights(), small_inputs(1, 4)
    first = [convolve(run["x"], weights[f"{FIRST}.weight"], weights[f"{FIRST}.bias"]) for run in runs]
    second = [convolve(np.maximum(x, 0), weights[f"{SECOND}.weight"], weights[f"{SECOND}.bias"]) for x in first]
    inputs = small_inputs(7)[0]
    x = round_activation(inputs["x"], min(run["x"].min() for run in runs), max(run["x"].max() for run in runs))
    x = convolve(x, round_weight(weights[f"{FIRST}.weight"]), weights[f"{FIRST}.bias"])
    x = round_activation(np.maximum(x, 0), 0.0, np.max(first))
    x = convolve(x, round_weight(weights[f"{SECOND}.weight"]), weights[f"{SECOND}.bias"])
    expected = round_activation(x, np.min(second), np.max(second))
    session = SimulatedSession(quantize_graph(graph, ranges, BLOCKS))
    got = session.run(to_tensors(**inputs))["y"].numpy()
    step = (np.max(second) - np.min(second)) / 255
    # A number close to the middle of two steps may be rounded to the other one.
    assert np.abs(got - expected).max() <= 1.01 * step
    assert np.mean(np.abs(got - expected) < 1e-4) > 0.95


def test_a_quantized_graph_keeps_its_operator_set_and_has_the_same_arithmetic_in_each(tmp_path):
    outputs = []
    for opset in OPSETS:
        (tmp_path / str(opset)).mkdir()
        graph, ranges = calibrate(write_small_graph(tmp_path / str(opset), opset=opset), tmp_path / f"{opset}-files")
        content = quantize_graph(graph, ranges, BLOCKS)
        assert check_graph(content, graph) == {"": opset}
        inputs = to_tensors(**small_inputs(7)[0])
        outputs.append(SimulatedSession(content).run(inputs)["y"].numpy())
    assert all(np.array_equal(output, outputs[0]) for output in outputs[1:])
    assert np.unique(outputs[0]).size > 10


def test_only_chosen_blocks_are_quantized(calibrated):
    graph, ranges = calibrated
    model = onnx.load_model_from_string(quantize_graph(graph, ranges, {"image_encoder.neck"}))
    integers = {tensor.name for tensor in model.graph.initializer if tensor.data_type == onnx.TensorProto.INT8}
    assert f"{SECOND}.weight_quantized" in integers
    assert not any(name.startswith(FIRST) for name in integers)
    assert [node.op_type for node in model.graph.node].count("Relu") == 1


def test_without_a_chosen_block_the_arithmetic_stays_float32(calibrated):
    graph, ranges = calibrated
    model = onnx.load_model_from_string(quantize_graph(graph, ranges, {"lifter.reduction"}))
    assert {node.op_type for node in model.graph.node} == {"Conv", "Relu"}


def test_the_relu_between_quantized_tensors_becomes_a_zero_point(calibrated):
    graph, ranges = calibrated
    model = onnx.load_model_from_string(quantize_graph(graph, ranges, BLOCKS))
    assert "Relu" not in {node.op_type for node in model.graph.node}
    zero_point = next(tensor for tensor in model.graph.initializer if tensor.name == "relu_zero_point")
    assert onnx.numpy_helper.to_array(zero_point) == 0


def test_a_quantized_file_holds_only_what_exported_files_hold(tiny_bundle, tiny_int8_bundle):
    for name in ("backbone", "lifter", "segmenter"):
        content = (tiny_int8_bundle / f"{name}.onnx").read_bytes()
        assert check_graph(content, tiny_int8_bundle / f"{name}.onnx") == {"": DEFAULT_OPSET}
        model, original = onnx.load_model_from_string(content), onnx.load(tiny_bundle / f"{name}.onnx")
        assert (model.ir_version, model.producer_name) == (original.ir_version, original.producer_name)
        assert (list(model.graph.input), list(model.graph.output)) == (
            list(original.graph.input),
            list(original.graph.output),
        )
        assert not model.metadata_props and not model.graph.doc_string


def test_weights_take_a_byte_each(tiny_int8_bundle):
    model = onnx.load(tiny_int8_bundle / "backbone.onnx")
    weights = [tensor for tensor in model.graph.initializer if tensor.name.endswith(".weight_quantized")]
    assert len(weights) > 10
    assert {tensor.data_type for tensor in weights} == {onnx.TensorProto.INT8}


def test_the_float32_graph_is_not_changed(calibrated):
    graph, ranges = calibrated
    before = graph.read_bytes()
    quantize_graph(graph, ranges, BLOCKS)
    assert graph.read_bytes() == before
    assert set(blocks_of(onnx.load(graph).graph)) == BLOCKS


def test_the_same_ranges_give_the_same_bytes(calibrated):
    graph, ranges = calibrated
    assert quantize_graph(graph, ranges, BLOCKS) == quantize_graph(graph, ranges, BLOCKS)


def test_the_recipe_says_what_was_done():
    assert (recipe().form, recipe().activations, recipe().weights) == ("QDQ", "uint8", "int8 per channel")
