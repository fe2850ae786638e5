"""Quantized graphs in OpenVINO: zeros that are padded to a dequantized tensor."""

from pathlib import Path

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from duospacenet.runtime.bundle.manifest import GraphSpec, TensorSpec
from duospacenet.runtime.openvino_session import OpenvinoSession
from duospacenet.runtime.session import to_tensors

NUM_CAMERAS, CHANNELS, WIDTH, SCALE, ZERO_POINT = 2, 8, 3, 0.05, 154


@pytest.mark.parametrize("height", [1, 2])
@pytest.mark.parametrize(("above", "below"), [(0, 1), (1, 0), (2, 1)])
def test_padding_behind_a_quantized_convolution_is_zero(height, above, below):
    shape = (NUM_CAMERAS, CHANNELS, height, WIDTH)
    session = OpenvinoSession(*_graph(shape, above, below), threads=1, precision="f32")
    x = np.random.default_rng(0).normal(size=shape).astype(np.float32)
    y = session.run(to_tensors(x=x))["y"].numpy()
    assert not y[:, :, :above].any()
    assert not y[:, :, above + height :].any()
    np.testing.assert_allclose(y[:, :, above : above + height], _quantize(2 * _quantize(x)), atol=1.01 * SCALE)


def _quantize(values: np.ndarray) -> np.ndarray:
    return (np.clip(np.round(values / SCALE) + ZERO_POINT, 0, 255) - ZERO_POINT) * SCALE


def _graph(shape: tuple[int, ...], above: int, below: int) -> tuple[bytes, GraphSpec, Path]:
    """A quantized 1×1 convolution that doubles every channel, and a Pad."""
    constants = {
        "scale": np.float32(SCALE),
        "zero_point": np.uint8(ZERO_POINT),
        "weight": (2 * np.eye(CHANNELS, dtype=np.int8))[..., None, None],
        "one": np.float32(1),
        "pads": np.array([0, 0, above, 0, 0, 0, below, 0]),
        "zero": np.float32(0),
    }
    nodes = [
        helper.make_node("QuantizeLinear", ["x", "scale", "zero_point"], ["x_int"]),
        helper.make_node("DequantizeLinear", ["x_int", "scale", "zero_point"], ["x_float"]),
        helper.make_node("DequantizeLinear", ["weight", "one"], ["weight_float"]),
        helper.make_node("Conv", ["x_float", "weight_float"], ["doubled"]),
        helper.make_node("QuantizeLinear", ["doubled", "scale", "zero_point"], ["doubled_int"]),
        helper.make_node("DequantizeLinear", ["doubled_int", "scale", "zero_point"], ["doubled_float"]),
        helper.make_node("Pad", ["doubled_float", "pads", "zero"], ["y"]),
    ]
    shapes = {"x": shape, "y": (*shape[:2], above + shape[2] + below, shape[3])}
    infos = [helper.make_tensor_value_info(name, TensorProto.FLOAT, size) for name, size in shapes.items()]
    initializers = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "quantized", infos[:1], infos[1:], initializers)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 20)], ir_version=10)
    onnx.checker.check_model(model)
    x, y = (TensorSpec(name=name, shape=size, dtype="float32") for name, size in shapes.items())
    spec = GraphSpec(file="quantized.onnx", sha256="", inputs=(x,), outputs=(y,))
    return model.SerializeToString(), spec, Path("quantized.onnx")
