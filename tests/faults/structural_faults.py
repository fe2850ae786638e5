"""Structural faults of a bundle, sampled at random: an element of an input or output, a weight, an operator, a field.

A fault changes a copy of an exported bundle. Its hashes and its seal are made right again, and its parity report still
says that it passed. Excluded are faults that cannot change any result on legal inputs:

- Values that the contract keeps constant: slot 0 of `frame_valid`, `time_delta_s` and `past_T_now`, and the last row of
  `past_T_now`.
- The limits of a Clip, which only keep huge coordinates out of GridSample, and the location of an invisible point,
  which is replaced once more before it is used.
- An exchange of two tensors that hold the same values, such as the operands of a product.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper

from duospacenet.runtime.bundle.manifest import Manifest, TensorSpec, read_manifest, slot_name
from tests.helpers.bundles import edit_graph

from .bench import nodes_of, set_attribute
from .manifest_faults import manifest_fault
from .tensor_edits import DTYPES, read_instead, remap, scale, set_values

Random = np.random.Generator
Change = Callable[[onnx.ModelProto], None]


@dataclass(frozen=True)
class StructuralFault:
    """A fault of a bundle. kind: what it changes. inject: puts it into a bundle folder."""

    name: str
    kind: str
    inject: Callable[[Path], Any]


def structural_fault(seed: int, bundle: Path) -> StructuralFault:
    """The fault with the number `seed`, for a bundle of any configuration. It is not yet in the bundle."""
    random, manifest = np.random.default_rng(seed), read_manifest(bundle)
    # A kind that the bundle does not have, such as two map classes to exchange, is sampled again.
    while True:
        kind = random.choice(list(KINDS), p=np.array(list(_SHARES)) / sum(_SHARES))
        if fault := KINDS[kind](random, manifest, bundle):
            name, inject = fault
            return StructuralFault(name, str(kind), inject)


Sampled = tuple[str, Callable[[Path], Any]] | None  # a fault's name and its injection


# ---------------------------------------------------------------------------------------------------------------------
# Inputs


def input_element(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """An element of a calibration, motion, time or mask is frozen, or read from another place."""
    graph = random.choice(["decoder", "decoder", "decoder", "projector"])
    specs = [spec for spec in _inputs(manifest, graph) if not spec.name.startswith("slot")]
    if not specs:
        return None
    spec = specs[random.integers(len(specs))]
    places = _legal_places(spec, of_window=graph == "decoder")
    if len(places) < 2:
        return None
    place, other = random.choice(len(places), 2, replace=False)
    index = np.arange(np.prod(spec.shape)).reshape(spec.shape)
    size, words = index.size, _place(spec, places[place])
    effect = random.choice(["frozen", "read from elsewhere", "exchanged"])
    if effect == "frozen":
        value = _frozen_value(spec, places[place], random)
        index[places[place]] = size
        return _in_graph(
            f"{graph}.{words} is always {value}", graph, lambda m: remap(m, spec.name, spec.shape, index, value)
        )
    index[places[place]], index[places[other]] = (
        np.ravel_multi_index(places[other], spec.shape),
        np.ravel_multi_index(places[place] if effect == "exchanged" else places[other], spec.shape),
    )
    verb = "exchanged with" if effect == "exchanged" else "read from"
    name = f"{graph}.{words} is {verb} {_place(spec, places[other])}"
    return _in_graph(name, graph, lambda m: remap(m, spec.name, spec.shape, index))


def input_axis(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """A whole camera, slot, row or column of an input is exchanged with another, or read from it."""
    graph = random.choice([name for name in manifest.graphs if name != "segmenter"])
    specs = [spec for spec in _inputs(manifest, graph) if max(spec.shape) > 1 and spec.dtype != "uint8"]
    if graph == "backbone" or not specs:
        return None
    spec = specs[random.integers(len(specs))]
    axes = [
        axis
        for axis, length in enumerate(spec.shape)
        if length > 1 and not (spec.name in ("past_T_now", "time_delta_s", "frame_valid") and axis == 0)
    ]
    if not axes:
        return None
    axis = int(random.choice(axes))
    # The last row of a motion is constant, and so are its exchanges with a row of another motion.
    length = 3 if spec.name == "past_T_now" else spec.shape[axis]
    one, other = random.choice(length, 2, replace=False)
    order = np.arange(spec.shape[axis])
    exchanged = bool(random.integers(2))
    order[one], order[other] = other, (one if exchanged else other)
    index = np.arange(np.prod(spec.shape)).reshape(spec.shape).take(order, axis=axis)
    verb = "exchanged with" if exchanged else "read from"
    name = f"{graph}.{spec.name}: axis {axis}, {one} is {verb} {other}"
    return _in_graph(name, graph, lambda m: remap(m, spec.name, spec.shape, index))


def image(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """Cameras, colours, rows or columns of the input images are exchanged, or a row is frozen."""
    (spec,) = _inputs(manifest, "backbone")
    axis = int(random.integers(4))
    if spec.shape[axis] < 2:
        return None
    one, other = random.choice(spec.shape[axis], 2, replace=False)
    order = np.arange(spec.shape[axis])
    order[[one, other]] = other, one
    index = np.arange(np.prod(spec.shape)).reshape(spec.shape)
    what = ("cameras", "rows", "columns", "colours")[axis]
    if axis in (1, 2) and random.integers(2):
        index[
            (slice(None), slice(one, one + 1))[:1] + ((slice(one, one + 1),) if axis == 1 else (slice(None), one))
        ] = index.size
        return _in_graph(
            f"backbone.images: {what[:-1]} {one} is black in every camera",
            "backbone",
            lambda m: remap(m, spec.name, spec.shape, index, np.zeros(1, np.uint8)),
        )
    camera = int(random.integers(spec.shape[0])) if axis else None
    if camera is None:
        index = index[order]
    else:
        index[camera] = index[camera].take(order, axis=axis - 1)
    where = "" if camera is None else f" of camera {camera}"
    return _in_graph(
        f"backbone.images: {what} {one} and {other}{where} are exchanged",
        "backbone",
        lambda m: remap(m, spec.name, spec.shape, index),
    )


def cached_value(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """The cached values of a slot are read from another slot, layer or camera, or are zero."""
    name = str(random.choice(manifest.memory))
    size = manifest.window.num_frames
    slot = int(random.integers(size))
    spec = next(spec for spec in _inputs(manifest, "decoder") if spec.name == slot_name(slot, name))
    index = np.arange(np.prod(spec.shape)).reshape(spec.shape)
    effects = ["slot", "slot", "exchanged slots", "layer", "camera", "camera zero", "channels", "cells"]
    effect = str(random.choice(effects))
    if effect in ("slot", "exchanged slots"):
        if size < 2:
            return None
        other = int(random.choice([number for number in range(size) if number != slot]))
        here, there = slot_name(slot, name), slot_name(other, name)
        names = {here: there} | ({there: here} if effect == "exchanged slots" else {})
        verb = "exchanged with" if effect == "exchanged slots" else "read from"
        return _in_graph(f"decoder.{here} is {verb} slot {other}", "decoder", lambda m: read_instead(m, names))
    if effect == "layer":
        others = [s.name for s in _inputs(manifest, "decoder") if s.shape == spec.shape and s.name != spec.name]
        others = [
            other for other in others if other.startswith(f"slot{slot}.") and other.partition(".")[2] in manifest.memory
        ]
        if not others:
            return None
        other_name = str(random.choice(others))
        return _in_graph(
            f"decoder.{spec.name} is read from {other_name}",
            "decoder",
            lambda m: read_instead(m, {spec.name: other_name}),
        )
    axis = {"camera": 0, "camera zero": 0, "channels": 1, "cells": 3}[effect]
    if spec.shape[axis] < 2:
        return None
    one, other = (int(number) for number in random.choice(spec.shape[axis], 2, replace=False))
    if effect == "camera zero":
        index[one] = index.size
        return _in_graph(
            f"decoder.{spec.name} is zero for camera {one}",
            "decoder",
            lambda m: remap(m, spec.name, spec.shape, index, np.zeros(1, np.float32)),
        )
    order = np.arange(spec.shape[axis])
    if effect == "cells":
        order = np.roll(order, 1)
    else:
        order[[one, other]] = other, one
    index = index.take(order, axis=axis)
    words = (
        "is shifted by one cell"
        if effect == "cells"
        else f"has {effect.removesuffix('s')}s {one} and {other} exchanged"
    )
    return _in_graph(f"decoder.{spec.name} {words}", "decoder", lambda m: remap(m, spec.name, spec.shape, index))


# ---------------------------------------------------------------------------------------------------------------------
# Outputs


def output(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """Rows or columns of an output are exchanged, negated, scaled or shifted."""
    graph = str(random.choice(list(manifest.graphs)))
    specs = manifest.graphs[graph].outputs  # type: ignore[index]
    spec = specs[random.integers(len(specs))]
    axes = [axis for axis, length in enumerate(spec.shape) if length > 1]
    axis = int(random.choice(axes))
    one, other = (int(number) for number in random.choice(spec.shape[axis], 2, replace=False))
    effect = str(random.choice(["exchanged", "negated", "scaled", "shifted"]))
    if effect == "exchanged":
        order = np.arange(spec.shape[axis])
        order[[one, other]] = other, one
        index = np.arange(np.prod(spec.shape)).reshape(spec.shape).take(order, axis=axis)
        name = f"{graph}.{spec.name}: axis {axis}, {one} and {other} are exchanged"
        return _in_graph(name, graph, lambda m: remap(m, spec.name, spec.shape, index))
    part = [1] * len(spec.shape)
    part[axis] = spec.shape[axis]
    factor, offset = np.ones(part, np.float32), np.zeros(part, np.float32)
    target = np.moveaxis(factor if effect != "shifted" else offset, axis, 0)
    target[one] = {"negated": -1.0, "scaled": 1.02, "shifted": 0.05}[effect]
    return _in_graph(
        f"{graph}.{spec.name}: axis {axis}, {one} is {effect}", graph, lambda m: scale(m, spec.name, factor, offset)
    )


# ---------------------------------------------------------------------------------------------------------------------
# Constants


def weight(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """A number, a row or a whole weight differs."""
    graph, name, values = _sample_constant(
        random, manifest, bundle, lambda a: a.dtype.kind == "f" and a.size > 16 and a.any()
    )
    index = np.unravel_index(random.integers(values.size), values.shape)
    effect = str(
        random.choice(["one number by 1 %", "one number by 10 %", "one number negated", "rows exchanged", "zero"])
    )
    changed = values.copy()
    if effect == "rows exchanged":
        rows = np.arange(len(values))
        if len(rows) < 2 or np.array_equal(values[0], values[1]):
            return None
        rows[[0, 1]] = 1, 0
        changed = values[rows]
    elif effect == "zero":
        changed = np.zeros_like(values)
    else:
        changed[index] *= {"one number by 1 %": 1.01, "one number by 10 %": 1.1, "one number negated": -1}[effect]
        if values[index] == 0:
            return None
    return _in_graph(f"{graph}.{name}: {effect}", graph, lambda m: set_values(m, name, changed))


def small_constant(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """A number of the arithmetic differs, such as the image size, the smallest depth or 2π."""
    graph, name, values = _sample_constant(
        random, manifest, bundle, lambda a: a.dtype.kind == "f" and 0 < a.size <= 16 and np.abs(a).max() < 1e5
    )
    model = onnx.load(bundle / f"{graph}.onnx")
    readers = [
        (node.op_type, place) for node in model.graph.node for place, read in enumerate(node.input) if read == name
    ]
    # See the docstring of this file. A Resize would give another shape.
    if all(op in ("Clip", "Resize") or (op == "Where" and (values == -1).all()) for op, _ in readers):
        return None
    index = np.unravel_index(random.integers(values.size), values.shape)
    changed = values.copy()
    changed[index] = values[index] * 1.05 if values[index] else 0.05
    reader = readers[0][0]
    return _in_graph(
        f"{graph}.{name}, read by {reader}: {values[index]:g} became {changed[index]:g}",
        graph,
        lambda m: set_values(m, name, changed),
    )


# ---------------------------------------------------------------------------------------------------------------------
# Operators


def index_of_gather(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """A Gather takes another slot, camera, row or column."""
    graph, model = _sample_graph(random, manifest, bundle, ["decoder", "projector"])
    shapes = _shapes(model)
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

    return _in_graph(f"{graph}.{output_name}: index {other} of {node.input[0]} instead of {index}", graph, change)


def operands(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """The operands of a Sub, Div, Where or Concat are exchanged."""
    graph, model = _sample_graph(random, manifest, bundle, list(manifest.graphs))
    shapes, numbers = _shapes(model), _value_numbers(model)
    choices = []
    for node in model.graph.node:
        first = {"Sub": 0, "Div": 0, "Where": 1, "Concat": 0, "Greater": 0, "Less": 0, "GreaterOrEqual": 0}.get(
            node.op_type
        )
        if first is None or len(node.input) < first + 2:
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

    return _in_graph(f"{graph}.{name}: operands {one} and {one + 1} of {operator} are exchanged", graph, change)


def skipped_operator(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """An operator returns its first input: a ReLU, an addition, a scaling or a norm is left out."""
    graph, model = _sample_graph(random, manifest, bundle, list(manifest.graphs))
    shapes, readers = _shapes(model), {name for node in model.graph.node for name in node.input}
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

    return _in_graph(f"{graph}.{name}: the {operator} is left out", graph, change)


def attribute(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """An attribute of an operator differs."""
    graph, model = _sample_graph(random, manifest, bundle, list(manifest.graphs))
    choices: list[tuple[str, str, str, Any]] = []
    for node in model.graph.node:
        for name, value in _OTHER_ATTRIBUTES.get(node.op_type, []):
            choices.append((node.output[0], node.op_type, name, value))
    if not choices:
        return None
    output_name, operator, name, value = choices[random.integers(len(choices))]

    def change(changed: onnx.ModelProto) -> None:
        set_attribute(next(each for each in changed.graph.node if output_name in each.output), name, value)

    return _in_graph(f"{graph}.{output_name}: {operator} with {name} {value}", graph, change)


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


def manifest_field(random: Random, manifest: Manifest, bundle: Path) -> Sampled:
    """A field of the manifest differs."""
    return manifest_fault(random, manifest)


KINDS: dict[str, Callable[[Random, Manifest, Path], Sampled]] = {
    "input element": input_element,
    "input axis": input_axis,
    "image": image,
    "cached value": cached_value,
    "output": output,
    "weight": weight,
    "small constant": small_constant,
    "index": index_of_gather,
    "operands": operands,
    "operator": skipped_operator,
    "attribute": attribute,
    "manifest": manifest_field,
}
_SHARES = (6, 3, 1, 4, 3, 2, 2, 3, 2, 2, 2, 5)


# ---------------------------------------------------------------------------------------------------------------------
# Helpers


def _in_graph(name: str, graph: str, change: Change) -> Sampled:
    return name, lambda bundle: edit_graph(bundle, graph, change)


def _inputs(manifest: Manifest, graph: str) -> tuple[TensorSpec, ...]:
    return manifest.graphs[graph].inputs if graph in manifest.graphs else ()  # type: ignore[index]


def _legal_places(spec: TensorSpec, of_window: bool) -> list[tuple[int, ...]]:
    """The indices of an input whose values are not constant by contract."""
    constant_slot = of_window and spec.name in ("frame_valid", "time_delta_s", "past_T_now")
    return [
        place
        for place in np.ndindex(*spec.shape)
        if not (constant_slot and place[0] == 0) and not (spec.name == "past_T_now" and place[1] == 3)
    ]


def _place(spec: TensorSpec, place: Sequence[int]) -> str:
    return f"{spec.name}[{', '.join(map(str, place))}]"


def _frozen_value(spec: TensorSpec, place: tuple[int, ...], random: Random) -> NDArray:
    """A plausible constant: what a trace of the first frame of a drive would hold."""
    if spec.dtype == "bool":
        return np.array([random.integers(2)], np.bool_)
    if spec.name == "past_T_now":
        return np.array([place[1] == place[2]], np.float32)
    if spec.name == "time_delta_s":
        return np.array([0.5 * place[0]], np.float32)
    return np.array([random.choice([0.0, 1.0, 100.0])], DTYPES[spec.dtype])


def _sample_graph(
    random: Random, manifest: Manifest, bundle: Path, names: Sequence[str]
) -> tuple[str, onnx.ModelProto]:
    graph = str(random.choice([name for name in names if name in manifest.graphs]))
    return graph, onnx.load(bundle / f"{graph}.onnx")


def _sample_constant(
    random: Random, manifest: Manifest, bundle: Path, accept: Callable[[NDArray], bool]
) -> tuple[str, str, NDArray]:
    found = []
    for graph in manifest.graphs:
        model = onnx.load(bundle / f"{graph}.onnx")
        arrays = [(tensor.name, numpy_helper.to_array(tensor)) for tensor in model.graph.initializer]
        found += [(graph, name, values) for name, values in arrays if accept(values)]
    graph, name, values = found[random.integers(len(found))]
    return str(graph), name, values


def _shapes(model: onnx.ModelProto) -> dict[str, tuple[int, ...]]:
    values = [*model.graph.input, *model.graph.value_info, *model.graph.output]
    shapes = {value.name: tuple(dim.dim_value for dim in value.type.tensor_type.shape.dim) for value in values}
    return shapes | {tensor.name: tuple(tensor.dims) for tensor in model.graph.initializer}


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
