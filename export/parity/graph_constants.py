"""The floating-point constants of a graph file: its initializers, and the tensors in the attributes of its nodes."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import AttributeProto, NodeProto, TensorProto, numpy_helper

_INTEGERS = (
    *(TensorProto.INT8, TensorProto.INT16, TensorProto.INT32, TensorProto.INT64, TensorProto.BOOL, TensorProto.STRING),
    *(TensorProto.UINT8, TensorProto.UINT16, TensorProto.UINT32, TensorProto.UINT64),
)


class GraphConstant(NamedTuple):
    """A constant of a graph.

    name: of its tensor. error: the largest rounding error of each number, in a quantized graph.
    """

    name: str
    values: NDArray
    error: NDArray[np.float64] | float = 0.0


def read_graph(file: Path | bytes) -> onnx.GraphProto:
    """Read a graph from the path or the content of its file."""
    return read_model(file).graph


def read_model(file: Path | bytes) -> onnx.ModelProto:
    """Read a graph with its operator set, from the path or the content of its file."""
    return onnx.load_model_from_string(file) if isinstance(file, bytes) else onnx.load_model(file)


def opset_of(model: onnx.ModelProto) -> int:
    """The version of ONNX's operator set in `model`, which has no other set."""
    (entry,) = model.opset_import
    return entry.version


def all_nodes(graph: onnx.GraphProto) -> Iterator[NodeProto]:
    """The nodes of `graph` and of the graphs inside its nodes."""
    for node in graph.node:
        yield node
        for attribute in node.attribute:
            for inner in _graphs(attribute):
                yield from all_nodes(inner)


def floating_point_constants(graph: onnx.GraphProto) -> Iterator[GraphConstant]:
    """The floating-point constants of `graph`. Integers are shapes and indices; no weight of the model is one."""
    for name, tensor in _tensors(graph):
        if tensor.data_type not in _INTEGERS:
            yield GraphConstant(name, numpy_helper.to_array(tensor))
    for node in all_nodes(graph):
        for attribute in node.attribute if node.op_type == "Constant" else ():
            if attribute.type in (AttributeProto.FLOAT, AttributeProto.FLOATS):
                values = attribute.floats or [attribute.f]
                yield GraphConstant(node.output[0], np.array(values, dtype=np.float32))


def _tensors(graph: onnx.GraphProto) -> Iterator[tuple[str, TensorProto]]:
    """All tensors in `graph`, with the name of the initializer or of the node's first output."""
    for tensor in graph.initializer:
        yield tensor.name, tensor
    for sparse in graph.sparse_initializer:
        yield sparse.values.name, sparse.values
    for node in graph.node:
        for attribute in node.attribute:
            for tensor in _attribute_tensors(attribute):
                yield node.output[0], tensor
            for inner in _graphs(attribute):
                yield from _tensors(inner)


def _attribute_tensors(attribute: AttributeProto) -> Iterator[TensorProto]:
    if attribute.type == AttributeProto.TENSOR:
        yield attribute.t
    elif attribute.type == AttributeProto.SPARSE_TENSOR:
        yield attribute.sparse_tensor.values
    yield from attribute.tensors


def _graphs(attribute: AttributeProto) -> list[onnx.GraphProto]:
    return [attribute.g] if attribute.type == AttributeProto.GRAPH else list(attribute.graphs)
