"""The dequantized form: float32 operators with the rounded weights, and contradictions between scales."""

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from duospacenet.export.parity.dequantized_graph import dequantize, is_quantized
from duospacenet.export.quantization.calibration import GraphCalibration
from duospacenet.export.quantization.quantized_graph import quantize_graph
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.onnxruntime_session import set_thread_pool_size
from tests.helpers.quantized import numbers, set_constant
from tests.helpers.small_graphs import FIRST, SECOND, small_inputs, small_weights, write_small_graph

BLOCKS = {"image_encoder.backbone.layer1", "image_encoder.neck"}


@pytest.fixture
def quantized(tmp_path) -> onnx.ModelProto:
    """The small graph, quantized on two inputs."""
    set_thread_pool_size(available_cores())
    graph, folder = write_small_graph(tmp_path), tmp_path / "temporary"
    folder.mkdir()
    calibration = GraphCalibration(graph, folder)
    for inputs in small_inputs(1, 2):
        calibration.add(inputs)
    return onnx.load_model_from_string(quantize_graph(graph, calibration.ranges(), BLOCKS))


def test_the_form_has_the_operators_of_the_float32_graph(quantized):
    form = dequantize(quantized)
    onnx.checker.check_model(form.model, full_check=True)
    assert [node.op_type for node in form.model.graph.node] == ["Conv", "Relu", "Conv"]
    assert [node.op_type for node in dequantize(quantized, with_relu=False).model.graph.node] == ["Conv", "Conv"]
    assert (form.clipped, form.failures) == (frozenset({"relu"}), ())


def test_every_weight_is_within_half_a_step_of_the_model(quantized):
    form, weights = dequantize(quantized), small_weights()
    constants = {tensor.name: numpy_helper.to_array(tensor) for tensor in form.model.graph.initializer}
    assert set(constants) == set(weights)
    for name, expected in weights.items():
        difference = np.abs(constants[name].astype(np.float64) - expected)
        assert (difference <= form.half_steps[name] * 1.00001).all()
    largest = np.abs(weights[f"{FIRST}.weight"]).reshape(4, -1).max(axis=1)
    assert form.half_steps[f"{FIRST}.weight"][:, 0, 0, 0] == pytest.approx(largest / 127 / 2)


def test_the_roundings_of_all_activations_are_listed(quantized):
    form = dequantize(quantized)
    assert set(form.activations) == {"x", "relu", "y"}
    low, high = form.activations["x"].range
    values = np.concatenate([inputs["x"] for inputs in small_inputs(1, 2)])
    assert (low, high) == pytest.approx((values.min(), values.max()), rel=0.01)


def test_a_float32_graph_is_not_quantized(tmp_path, quantized):
    assert is_quantized(quantized.graph)
    assert not is_quantized(onnx.load(write_small_graph(tmp_path)).graph)


def test_a_changed_scale_contradicts_the_scale_of_the_bias(quantized):
    set_constant(quantized, "relu_scale", 1.01 * numbers(quantized, "relu_scale"))
    (failure,) = dequantize(quantized).failures
    assert failure.startswith("y: expected the scale of relu times that of the weight as the scale of the bias")


def test_a_changed_scale_of_a_weight_contradicts_the_scale_of_the_bias(quantized):
    scales = numbers(quantized, f"{SECOND}.weight_scale")
    scales[1] *= 0.5
    set_constant(quantized, f"{SECOND}.weight_scale", scales)
    assert len(dequantize(quantized).failures) == 1


def test_a_scale_of_zero_is_reported(quantized):
    set_constant(quantized, "y_scale", np.zeros(()))
    assert dequantize(quantized).failures == ("y: expected a scale above 0; got 0",)


def test_two_scales_of_one_tensor_are_reported(quantized):
    other = numpy_helper.from_array(np.float32(2 * numbers(quantized, "relu_scale")), "other_scale")
    quantized.graph.initializer.append(other)
    node = next(node for node in quantized.graph.node if node.name == "relu_QuantizeLinear")
    node.input[1] = "other_scale"
    assert "relu: QuantizeLinear and DequantizeLinear have different scales" in dequantize(quantized).failures


def test_a_rounded_tensor_that_another_operator_reads_is_reported(quantized):
    """The form stays a valid model, so that the other checks can run."""
    quantized.graph.node.append(onnx.helper.make_node("Cast", ["relu_QuantizeLinear_Output"], ["cast"], to=1))
    form = dequantize(quantized)
    assert form.failures == ("relu_QuantizeLinear_Output: expected DequantizeLinear behind QuantizeLinear; got others",)
    onnx.checker.check_model(form.model, full_check=True)


def test_a_dequantizer_of_another_tensor_is_reported(quantized):
    node = next(node for node in quantized.graph.node if node.name == "relu_DequantizeLinear")
    quantized.graph.node.append(onnx.helper.make_node("Identity", ["relu_QuantizeLinear_Output"], ["other"]))
    node.input[0] = "other"
    failures = dequantize(quantized).failures
    assert any(line.endswith("expected QuantizeLinear before DequantizeLinear; got none") for line in failures)


def test_two_roundings_of_one_tensor_are_reported(quantized):
    scale = numpy_helper.from_array(np.float32(2 * numbers(quantized, "relu_scale")), "other_scale")
    quantized.graph.initializer.append(scale)
    parameters = ["other_scale", "relu_zero_point"]
    quantized.graph.node.extend(
        [
            onnx.helper.make_node("QuantizeLinear", ["relu", *parameters], ["again"]),
            onnx.helper.make_node("DequantizeLinear", ["again", *parameters], ["twice"]),
        ]
    )
    assert "relu: expected one rounding; got two with different scales" in dequantize(quantized).failures


def test_copies_of_a_shared_bias_keep_their_own_numbers(tiny_int8_bundle):
    """The quantizer copies a bias that several convolutions add, because its scale depends on their inputs."""
    form = dequantize(onnx.load(tiny_int8_bundle / "backbone.onnx"))
    copies = [name for name in form.half_steps if "#" in name]
    for name in copies:
        original = name.partition("#")[0]
        constants = {tensor.name: numpy_helper.to_array(tensor) for tensor in form.model.graph.initializer}
        steps = form.half_steps[name] + form.half_steps[original]
        assert (np.abs(constants[name] - constants[original]) <= 1.00001 * steps).all()
    assert len(copies) >= 3
