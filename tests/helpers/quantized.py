"""A quantized bundle of `tiny`, and changes to quantized graphs."""

import numpy as np
import onnx
from onnx import NodeProto, TensorProto, numpy_helper

from duospacenet.jobs import quantize_bundle

CALIBRATION, JUDGING = "synthetic:5:3", "synthetic:6:1"


def quantize_tiny(bundle, out, **options):
    """Quantize a bundle of `tiny` on a few frames."""
    defaults = {"eval_sources": [JUDGING], "metrics": False}  # random weights have no metrics worth comparing
    return quantize_bundle(bundle, CALIBRATION, out, **defaults | options)


def nodes_of_type(model: onnx.ModelProto, *operators: str) -> list[NodeProto]:
    return [node for node in model.graph.node if node.op_type in operators]


def constant(model: onnx.ModelProto, name: str) -> TensorProto:
    """The initializer `name`."""
    return next(tensor for tensor in model.graph.initializer if tensor.name == name)


def set_constant(model: onnx.ModelProto, name: str, values: np.ndarray) -> None:
    """Replace the numbers of an initializer, with the same type."""
    tensor = constant(model, name)
    array = numpy_helper.to_array(tensor)
    tensor.CopyFrom(numpy_helper.from_array(np.asarray(values).astype(array.dtype).reshape(array.shape), name))


def numbers(model: onnx.ModelProto, name: str) -> np.ndarray:
    """A copy of the numbers of an initializer."""
    return numpy_helper.to_array(constant(model, name)).copy()
