"""Edits of a graph file that change single elements of a tensor, with operators that exported graphs also hold."""

from collections.abc import Sequence

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import helper, numpy_helper

from .bench import constant

DTYPES = {"float32": np.float32, "uint8": np.uint8, "bool": np.bool_}


def remap(
    model: onnx.ModelProto, name: str, shape: Sequence[int], sources: NDArray[np.int64], extra: NDArray | None = None
) -> None:
    """Replace the tensor `name` by one whose element i is the element `sources[i]` of the original, both flattened.

    name: an input or an output of the graph. shape: its shape.
    extra: further values, which have the numbers after those of the original.
    """
    prefix = f"fault.{name}"
    old, new = _split(model, name, prefix)
    flat, gathered, all_values = f"{prefix}.flat", f"{prefix}.gathered", f"{prefix}.flat"
    nodes = [helper.make_node("Reshape", [old, constant(model, np.array([-1]), f"{prefix}.line")], [flat])]
    if extra is not None:
        all_values = f"{prefix}.all"
        values = constant(model, np.atleast_1d(extra), f"{prefix}.extra")
        nodes.append(helper.make_node("Concat", [flat, values], [all_values], axis=0))
    places = constant(model, sources.ravel().astype(np.int64), f"{prefix}.sources")
    nodes.append(helper.make_node("Gather", [all_values, places], [gathered], axis=0))
    original = constant(model, np.array(shape, np.int64), f"{prefix}.shape")
    nodes.append(helper.make_node("Reshape", [gathered, original], [new]))
    insert(model, name, nodes)


def scale(model: onnx.ModelProto, name: str, factor: NDArray, offset: NDArray | None = None) -> None:
    """Multiply an input or an output of the graph by `factor`, and add `offset`."""
    prefix = f"fault.{name}"
    old, new = _split(model, name, prefix)
    middle = new if offset is None else f"{prefix}.scaled"
    nodes = [helper.make_node("Mul", [old, constant(model, factor, f"{prefix}.factor")], [middle])]
    if offset is not None:
        nodes.append(helper.make_node("Add", [middle, constant(model, offset, f"{prefix}.offset")], [new]))
    insert(model, name, nodes)


def insert(model: onnx.ModelProto, name: str, nodes: list[onnx.NodeProto]) -> None:
    """Insert nodes where the tensor `name` begins: before all nodes for an input, after them for an output."""
    if any(value.name == name for value in model.graph.input):
        for node in reversed(nodes):
            model.graph.node.insert(0, node)
    else:
        model.graph.node.extend(nodes)


def read_instead(model: onnx.ModelProto, names: dict[str, str]) -> None:
    """Let every node read another tensor: the new name by the old one."""
    for node in model.graph.node:
        node.input[:] = [names.get(name, name) for name in node.input]


def set_values(model: onnx.ModelProto, name: str, values: NDArray) -> None:
    """Replace the values of an initializer."""
    tensor = next(tensor for tensor in model.graph.initializer if tensor.name == name)
    tensor.CopyFrom(numpy_helper.from_array(values.astype(numpy_helper.to_array(tensor).dtype), name))


def _split(model: onnx.ModelProto, name: str, prefix: str) -> tuple[str, str]:
    """Cut the tensor `name` in two. Returns the name of the original values and that of the changed ones."""
    if any(value.name == name for value in model.graph.input):
        read_instead(model, {name: f"{prefix}.changed"})
        return name, f"{prefix}.changed"
    for node in model.graph.node:
        node.output[:] = [f"{prefix}.original" if output == name else output for output in node.output]
        node.input[:] = [f"{prefix}.original" if read == name else read for read in node.input]
    return f"{prefix}.original", name
