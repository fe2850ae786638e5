"""Faults of the constants and the outputs of a graph, sampled at random."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import numpy_helper

from duospacenet.runtime.bundle.manifest import Manifest

from .sampled_fault import Random, Sampled, in_graph
from .tensor_edits import remap, scale, set_values


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
        return in_graph(name, graph, lambda m: remap(m, spec.name, spec.shape, index))
    part = [1] * len(spec.shape)
    part[axis] = spec.shape[axis]
    factor, offset = np.ones(part, np.float32), np.zeros(part, np.float32)
    target = np.moveaxis(factor if effect != "shifted" else offset, axis, 0)
    target[one] = {"negated": -1.0, "scaled": 1.02, "shifted": 0.05}[effect]
    return in_graph(
        f"{graph}.{spec.name}: axis {axis}, {one} is {effect}", graph, lambda m: scale(m, spec.name, factor, offset)
    )


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
    return in_graph(f"{graph}.{name}: {effect}", graph, lambda m: set_values(m, name, changed))


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
    return in_graph(
        f"{graph}.{name}, read by {reader}: {values[index]:g} became {changed[index]:g}",
        graph,
        lambda m: set_values(m, name, changed),
    )


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
