"""Faults of the operators of a graph, sampled at random: other indices, operands or attributes."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import numpy_helper

from duospacenet.runtime.bundle.manifest import Manifest

from .bench import constant, nodes_of, set_attribute
from .sampled_fault import Random, Sampled, in_graph, sample_graph, shapes_of
from .tensor_edits import read_instead


def index_of_gather(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """A Gather takes another slot, camera, row or column."""
    graph, model = sample_graph(random, manifest, bundle, ["decoder", "projector"])
    shapes = shapes_of(model)
    values = {tensor.name: numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    gathers = [
        node
        for node in nodes_of(model, "Gather")
        if node.input[1] in values and values[node.input[1]].ndim == 0 and _axis_length(node, shapes) > 1
    ]
    if not gathers:
        return None
    node = gathers[random.integers(len(gathers))]
    length, index = _axis_length(node, shapes), int(values[node.input[1]])
    other = int(random.choice([number for number in range(length) if number != index % length]))
    output_name = node.output[0]

    def change(changed: onnx.ModelProto) -> None:
        target = next(each for each in changed.graph.node if output_name in each.output)
        tensor = numpy_helper.from_array(np.array(other, np.int64), "fault.index")
        changed.graph.initializer.append(tensor)
        target.input[1] = "fault.index"

    return in_graph(f"{graph}.{output_name}: index {other} of {node.input[0]} instead of {index}", graph, change)


def slice_of_another_place(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """A Slice begins one place later or earlier, with the same length."""
    graph, model = sample_graph(random, manifest, bundle, list(manifest.graphs))
    shapes = shapes_of(model)
    values = {tensor.name: numpy_helper.to_array(tensor) for tensor in model.graph.initializer}
    choices = []
    for node in nodes_of(model, "Slice"):
        starts, ends, axes = (values.get(name) for name in node.input[1:4])
        steps = values.get(node.input[4]) if len(node.input) > 4 else np.array([1])
        if starts is None or ends is None or axes is None or steps is None or len(starts) > 1 or steps[0] != 1:
            continue
        start, end, length = int(starts[0]), int(ends[0]), shapes.get(node.input[0], ())[int(axes[0])]
        choices += [(node.output[0], start, end, by) for by in (-1, 1) if start + by >= 0 and end + by <= length]
    if not choices:
        return None
    name, start, end, by = choices[random.integers(len(choices))]

    def change(changed: onnx.ModelProto) -> None:
        node = next(each for each in changed.graph.node if name in each.output)
        node.input[1] = constant(changed, np.array([start + by]), "fault.start")
        node.input[2] = constant(changed, np.array([end + by]), "fault.end")

    return in_graph(f"{graph}.{name}: {start + by}:{end + by} instead of {start}:{end}", graph, change)


def split_in_another_order(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """Two parts of a Split, which have the same shape, are exchanged."""
    graph, model = sample_graph(random, manifest, bundle, list(manifest.graphs))
    shapes, readers = shapes_of(model), {name for node in model.graph.node for name in node.input}
    choices = [
        (one, other)
        for node in nodes_of(model, "Split")
        for one, other in pairwise(node.output)
        if shapes.get(one) == shapes.get(other) is not None and {one, other} & readers
    ]
    if not choices:
        return None
    one, other = choices[random.integers(len(choices))]
    return in_graph(
        f"{graph}: {one} and {other} are exchanged", graph, lambda m: read_instead(m, {one: other, other: one})
    )


def operands(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """The operands of a Sub, Div, Where or Concat are exchanged."""
    graph, model = sample_graph(random, manifest, bundle, list(manifest.graphs))
    shapes, numbers = shapes_of(model), _value_numbers(model)
    choices = []
    for node in model.graph.node:
        first = {"Sub": 0, "Div": 0, "Where": 1, "Concat": 0, "Greater": 0, "Less": 0, "GreaterOrEqual": 0}.get(
            node.op_type
        )
        if first is None or len(node.input) < first + 2 or _is_summed(model, node.output[0]):
            continue
        for one in range(first, len(node.input) - 1):
            pair = node.input[one], node.input[one + 1]
            same_shape = shapes.get(pair[0]) is not None and shapes.get(pair[0]) == shapes.get(pair[1])
            if same_shape and numbers[pair[0]] != numbers[pair[1]]:
                choices.append((node.output[0], node.op_type, one))
    if not choices:
        return None
    name, operator, one = choices[random.integers(len(choices))]

    def change(changed: onnx.ModelProto) -> None:
        node = next(each for each in changed.graph.node if name in each.output)
        node.input[one], node.input[one + 1] = node.input[one + 1], node.input[one]

    return in_graph(f"{graph}.{name}: operands {one} and {one + 1} of {operator} are exchanged", graph, change)


def skipped_operator(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """An operator returns its first input: a ReLU, an addition, a scaling or a norm is left out."""
    graph, model = sample_graph(random, manifest, bundle, list(manifest.graphs))
    shapes, readers = shapes_of(model), {name for node in model.graph.node for name in node.input}
    readers |= {value.name for value in model.graph.output}
    choices = [
        node
        for node in model.graph.node
        if node.op_type in ("Relu", "Add", "Sub", "Mul", "Div", "LayerNormalization", "Softmax", "Reciprocal")
        and shapes.get(node.input[0]) == shapes.get(node.output[0])
        and node.output[0] in readers
    ]
    if not choices:
        return None
    node = choices[random.integers(len(choices))]
    name, operator = node.output[0], node.op_type

    def change(changed: onnx.ModelProto) -> None:
        target = next(each for each in changed.graph.node if name in each.output)
        target.op_type = "Identity"
        del target.input[1:], target.attribute[:]

    return in_graph(f"{graph}.{name}: the {operator} is left out", graph, change)


def attribute(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """An attribute of an operator differs."""
    graph, model = sample_graph(random, manifest, bundle, list(manifest.graphs))
    choices: list[tuple[str, str, str, Any]] = []
    for node in model.graph.node:
        for name, value in _OTHER_ATTRIBUTES.get(node.op_type, []):
            choices.append((node.output[0], node.op_type, name, value))
    if not choices:
        return None
    output_name, operator, name, value = choices[random.integers(len(choices))]

    def change(changed: onnx.ModelProto) -> None:
        set_attribute(next(each for each in changed.graph.node if output_name in each.output), name, value)

    return in_graph(f"{graph}.{output_name}: {operator} with {name} {value}", graph, change)


_OTHER_ATTRIBUTES: dict[str, list[tuple[str, Any]]] = {
    "GridSample": [
        ("mode", "nearest"),
        ("padding_mode", "border"),
        ("padding_mode", "reflection"),
        ("align_corners", 1),
    ],
    "LayerNormalization": [("epsilon", 1e-4), ("epsilon", 1e-6), ("epsilon", 1.5e-5)],
    "BatchNormalization": [("epsilon", 1e-4)],
    "Softmax": [("axis", 1), ("axis", 0)],
    "Gemm": [("alpha", 1.01), ("beta", 0.99)],
    "Resize": [("mode", "linear")],
}


def _is_summed(model: onnx.ModelProto, name: str) -> bool:
    """Whether a tensor is only summed, so that the order of its parts does not matter."""
    readers = [node.op_type for node in model.graph.node if name in node.input]
    return bool(readers) and set(readers) == {"ReduceSum"}


def _axis_length(node: onnx.NodeProto, shapes: dict[str, tuple[int, ...]]) -> int:
    axis = next((each.i for each in node.attribute if each.name == "axis"), 0)
    shape = shapes.get(node.input[0], ())
    return shape[axis] if shape else 0


def _value_numbers(model: onnx.ModelProto) -> dict[str, int]:
    """A number per tensor. Tensors that are computed in the same way from the same tensors have the same number."""
    numbers: dict[str, int] = {"": -1}
    known: dict[Any, int] = {}
    for value in model.graph.input:
        numbers[value.name] = known.setdefault(value.name, len(known))
    for tensor in model.graph.initializer:
        key = tensor.data_type, tuple(tensor.dims), numpy_helper.to_array(tensor).tobytes()
        numbers[tensor.name] = known.setdefault(key, len(known))
    for node in model.graph.node:
        inputs = tuple(numbers[name] for name in node.input)
        attributes = tuple(sorted(each.SerializeToString() for each in node.attribute))
        for place, name in enumerate(node.output):
            key = (node.op_type, inputs, attributes, place)
            numbers[name] = inputs[0] if node.op_type == "Identity" else known.setdefault(key, len(known))
    return numbers
