"""A small convolutional graph with the names of an export, and its arithmetic in numpy."""

from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from duospacenet.runtime.bundle.operators import DEFAULT_OPSET

FIRST, SECOND = "model.image_encoder.backbone.layer1.0.conv1", "model.image_encoder.neck.output.0"
SHAPE = (1, 3, 6, 8)


def small_weights(seed: int = 0) -> dict[str, NDArray[np.float32]]:
    """Weights and biases of two convolutions, 3 to 4 to 2 channels."""
    generator = np.random.default_rng(seed)
    return {
        f"{FIRST}.weight": generator.normal(size=(4, 3, 3, 3)).astype(np.float32),
        f"{FIRST}.bias": generator.normal(size=4).astype(np.float32),
        f"{SECOND}.weight": generator.normal(size=(2, 4, 1, 1)).astype(np.float32),
        f"{SECOND}.bias": generator.normal(size=2).astype(np.float32),
    }


def small_model(weights: dict[str, NDArray[np.float32]], opset: int = DEFAULT_OPSET) -> onnx.ModelProto:
    """x → Conv 3×3 → Relu → Conv 1×1 → y, in the form of an exported graph."""
    nodes = [
        helper.make_node("Conv", ["x", f"{FIRST}.weight", f"{FIRST}.bias"], ["conv"], name="node_conv", pads=[1] * 4),
        helper.make_node("Relu", ["conv"], ["relu"], name="node_relu"),
        helper.make_node("Conv", ["relu", f"{SECOND}.weight", f"{SECOND}.bias"], ["y"], name="node_conv_1"),
    ]
    graph = helper.make_graph(
        nodes,
        "backbone",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, SHAPE)],
        [helper.make_tensor_value_info("y", TensorProto.FLOAT, (1, 2, 6, 8))],
        [numpy_helper.from_array(value, name) for name, value in weights.items()],
    )
    return helper.make_model(
        graph, ir_version=10, opset_imports=[helper.make_opsetid("", opset)], producer_name="duospacenet"
    )


def write_small_graph(folder: Path, seed: int = 0, opset: int = DEFAULT_OPSET) -> Path:
    """Write the small graph to a new file."""
    path = folder / "backbone.onnx"
    path.write_bytes(small_model(small_weights(seed), opset).SerializeToString())
    return path


def small_inputs(seed: int, number: int = 1) -> list[dict[str, NDArray[np.float32]]]:
    """Inputs of the small graph."""
    generator = np.random.default_rng(seed)
    return [{"x": generator.normal(size=SHAPE).astype(np.float32)} for _ in range(number)]


def convolve(x: NDArray, weight: NDArray, bias: NDArray) -> NDArray[np.float64]:
    """A convolution with stride 1 that keeps the size, as a loop over outputs."""
    margin = weight.shape[-1] // 2
    padded = np.pad(x.astype(np.float64), ((0, 0), (0, 0), (margin, margin), (margin, margin)))
    result = np.zeros((1, len(weight), *x.shape[2:]))
    for channel, row, column in np.ndindex(result.shape[1:]):
        window = padded[0, :, row : row + weight.shape[2], column : column + weight.shape[3]]
        result[0, channel, row, column] = (window * weight[channel]).sum() + bias[channel]
    return result
