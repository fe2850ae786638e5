"""A quantized graph and a new export of its float32 graph, in forms that can be compared operator by operator."""

from collections.abc import Mapping

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import NodeProto, numpy_helper

from .dequantized_graph import COPY_MARK, DequantizedGraph

_ROUNDING = 1e-5  # of a float32 scale; relative to half a step


def comparable_models(form: DequantizedGraph, expected: onnx.ModelProto) -> tuple[onnx.ModelProto, onnx.ModelProto]:
    """The quantized graph and the new export, which are equal if the quantizer changed nothing else.

    form: of the quantized graph, with the operators of the file.
    expected: the new export. It loses the Relus whose work the rounding does.

    Both are sorted by the names of the tensors. A rounded constant becomes the expected one if it is within half a
    step of it.
    """
    return _sorted(_with_expected_constants(form, expected)), _sorted(_without_relus(expected, form.clipped))


def _with_expected_constants(form: DequantizedGraph, expected: onnx.ModelProto) -> onnx.ModelProto:
    constants = {tensor.name: numpy_helper.to_array(tensor) for tensor in expected.graph.initializer}
    model = onnx.ModelProto()
    model.CopyFrom(form.model)
    for node in model.graph.node:
        node.input[:] = [name.partition(COPY_MARK)[0] for name in node.input]
    tensors: dict[str, onnx.TensorProto] = {}
    for tensor in form.model.graph.initializer:
        name = tensor.name.partition(COPY_MARK)[0]
        value = _expected_if_near(numpy_helper.to_array(tensor), form.half_steps.get(tensor.name), constants.get(name))
        copy = numpy_helper.from_array(value, name)
        # A copy that differs from the expected numbers must not be hidden by another one that does not.
        if name not in tensors or value is not constants.get(name):
            tensors[name] = copy
    del model.graph.initializer[:]
    model.graph.initializer.extend(tensors.values())
    return model


def _expected_if_near(value: NDArray, half_step: NDArray[np.float64] | None, expected: NDArray | None) -> NDArray:
    if half_step is None or expected is None or value.shape != expected.shape or expected.dtype != np.float32:
        return value
    near = np.abs(value.astype(np.float64) - expected) <= half_step * (1 + _ROUNDING)
    return expected if near.all() else value


def _without_relus(model: onnx.ModelProto, clipped: frozenset[str]) -> onnx.ModelProto:
    """The model without the Relus whose results are in `clipped`. The operator before has their result instead."""
    result = onnx.ModelProto()
    result.CopyFrom(model)
    readers: Mapping[str, list[NodeProto]] = _readers(model)
    relus = {
        node.input[0]: node.output[0]
        for node in model.graph.node
        if node.op_type == "Relu" and node.output[0] in clipped and len(readers[node.input[0]]) == 1
    }
    del result.graph.node[:]
    for node in model.graph.node:
        if node.op_type == "Relu" and node.input[0] in relus:
            continue
        kept = result.graph.node.add()
        kept.CopyFrom(node)
        kept.output[:] = [relus.get(name, name) for name in node.output]
    return result


def _readers(model: onnx.ModelProto) -> dict[str, list[NodeProto]]:
    readers: dict[str, list[NodeProto]] = {}
    for node in model.graph.node:
        for name in node.input:
            readers.setdefault(name, []).append(node)
    return readers


def _sorted(model: onnx.ModelProto) -> onnx.ModelProto:
    nodes = sorted(model.graph.node, key=lambda node: node.output[0])
    result = onnx.ModelProto()
    result.CopyFrom(model)
    del result.graph.node[:]
    result.graph.node.extend(nodes)
    return result
