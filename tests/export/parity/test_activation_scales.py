"""The scales of activations, compared with the numbers on frames."""

import numpy as np
import onnx
import pytest

from duospacenet.export.parity.activation_scales import DequantizedSession
from duospacenet.export.parity.dequantized_graph import dequantize
from duospacenet.export.quantization.calibration import GraphCalibration
from duospacenet.export.quantization.quantized_graph import quantize_graph
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.onnxruntime_session import set_thread_pool_size
from tests.helpers.quantized import numbers, set_constant
from tests.helpers.small_graphs import FIRST, SECOND, convolve, small_inputs, small_weights, write_small_graph


@pytest.fixture
def quantized(tmp_path) -> onnx.ModelProto:
    """The small graph, calibrated on two inputs."""
    set_thread_pool_size(available_cores())
    graph, folder = write_small_graph(tmp_path), tmp_path / "temporary"
    folder.mkdir()
    calibration = GraphCalibration(graph, folder)
    for inputs in small_inputs(1, 2):
        calibration.add(inputs)
    blocks = {"image_encoder.backbone.layer1", "image_encoder.neck"}
    return onnx.load_model_from_string(quantize_graph(graph, calibration.ranges(), blocks))


def failures_on(model: onnx.ModelProto, inputs: list[dict]) -> list[str]:
    session = DequantizedSession(dequantize(model))
    for each in inputs:
        session.measure(each)
    return list(session.scale_failures())


def test_the_scales_of_a_calibration_fit_other_inputs(quantized):
    assert failures_on(quantized, small_inputs(9, 3)) == []


@pytest.mark.parametrize("factor", [1 / 6, 6])
def test_a_wrong_scale_is_found_by_the_numbers_on_frames(quantized, factor):
    """No bias contradicts the scale of an output."""
    set_constant(quantized, "y_scale", factor * numbers(quantized, "y_scale"))
    (failure,) = failures_on(quantized, small_inputs(9, 3))
    assert failure.startswith("y: expected a scale for numbers from ")


def test_a_wrong_zero_point_is_found(quantized):
    set_constant(quantized, "y_scale", numbers(quantized, "y_scale") / 4)
    set_constant(quantized, "y_zero_point", np.array(255))  # no number above 0 is left
    assert len(failures_on(quantized, small_inputs(9, 3))) == 1


def test_a_tensor_of_zeros_fits_every_scale(quantized):
    """A Relu can be closed on all frames."""
    set_constant(quantized, f"{FIRST}.bias_quantized", np.full(4, -(2**24)))
    assert "relu" not in [line.split(":")[0] for line in failures_on(quantized, small_inputs(9, 3))]


def test_a_tensor_without_any_number_is_reported(quantized):
    """Without a frame there is nothing to compare with."""
    assert len(failures_on(quantized, [])) == 3


def test_a_graph_that_takes_fewer_cameras_runs_group_by_group(quantized):
    """Its outputs are concatenated along the first axis, as in the pipeline."""
    for node in quantized.graph.node:
        node.input[:] = ["images" if name == "x" else name for name in node.input]
    quantized.graph.input[0].name = "images"
    session = DequantizedSession(dequantize(quantized))
    images = np.concatenate([inputs["x"] for inputs in small_inputs(9, 3)])
    alone = [session.outputs_for({"images": images[index : index + 1]})["y"] for index in range(3)]
    assert np.array_equal(session.outputs_for({"images": images})["y"], np.concatenate(alone))
    session.measure({"images": images})
    assert list(session.scale_failures()) == []
    low, high = session._ranges[0]
    assert (low, high) == (images.min(), images.max())


def test_the_session_computes_the_dequantized_form(quantized):
    weights, inputs = small_weights(), small_inputs(9)[0]
    x = convolve(inputs["x"], weights[f"{FIRST}.weight"], weights[f"{FIRST}.bias"])
    expected = convolve(np.maximum(x, 0), weights[f"{SECOND}.weight"], weights[f"{SECOND}.bias"])
    got = DequantizedSession(dequantize(quantized)).outputs_for(inputs)["y"]
    # Only the weights are rounded.
    assert np.linalg.norm(got - expected) <= 0.02 * np.linalg.norm(expected)
    assert np.abs(got - expected).max() > 1e-4
