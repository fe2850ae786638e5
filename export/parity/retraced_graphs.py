"""The graphs of a bundle, compared with a new export of the model.

Inputs show what a graph computes on these inputs. The comparison with a new export shows the rest: that no operator
clips a range, freezes a value or skips a case that no input happened to exercise. With the same versions of the
exporter, two exports of a model have the same operators with the same names.
"""

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from numpy.typing import NDArray
from onnx import NodeProto, ValueInfoProto, helper, numpy_helper

from ...runtime.bundle.manifest import Manifest, graph_file_name
from ...runtime.progress import Progress, no_progress
from ...runtime.versions import library_versions
from ..graphs import Graph
from ..operator_forms import OperatorForms
from ..tracing import trace
from .dequantized_graph import DequantizedGraph
from .quantized_retrace import comparable_models

# Another CPU may round differently when the exporter folds constants.
CONSTANT_TOLERANCE = 1e-6  # relative to the largest number of the constant
EXPORTER = ("duospacenet", "torch", "onnx", "onnx-ir", "onnxscript")  # the packages that determine the graphs


@dataclass(frozen=True)
class Retrace:
    """The result. graphs: names of the compared graphs; empty if they were not compared.

    skipped: why they were not compared. differences: the first difference of each graph that differs, one line each.
    """

    graphs: tuple[str, ...] = ()
    skipped: str | None = None
    differences: tuple[str, ...] = ()


def retrace_graphs(
    bundle: Path,
    manifest: Manifest,
    graphs: Sequence[Graph],
    progress: Progress = no_progress,
    quantized: Mapping[str, DequantizedGraph] | None = None,
) -> Retrace:
    """Export `graphs` again, and compare them with those of `bundle`.

    graphs: those of the model, from `graphs_to_export`.
    quantized: the dequantized form of each quantized graph of the bundle.

    A bundle that other versions of the toolkit or of the exporter have written is not compared.
    """
    if reason := _other_versions(manifest.versions):
        return Retrace(skipped=reason)
    differences: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for graph in progress(graphs, "new export"):
            file = Path(folder) / graph_file_name(graph.name)
            # Without gradients the tracer would record that mode as operators.
            with torch.enable_grad():
                trace(graph, file, OperatorForms.of(manifest))
            stored, expected = onnx.load_model(bundle / file.name), onnx.load_model(file)
            if quantized and graph.name in quantized:
                stored, expected = comparable_models(quantized[graph.name], expected)
            first = next(graph_differences(stored, expected), None)
            differences += [f"new export, {graph.name}: {first}"] if first else []
    return Retrace(tuple(graph.name for graph in graphs), differences=tuple(differences))


def graph_differences(stored: onnx.ModelProto, expected: onnx.ModelProto) -> Iterator[str]:
    """Yield the differences of two graph files, one line each. Texts for readers do not count."""
    yield from _different("operator sets", _opsets(stored), _opsets(expected))
    yield from _different("inputs", _tensors(stored.graph.input), _tensors(expected.graph.input))
    yield from _different("outputs", _tensors(stored.graph.output), _tensors(expected.graph.output))
    for node, other in zip(stored.graph.node, expected.graph.node, strict=False):
        yield from _different("operator", _describe(node), _describe(other))
    yield from _different("number of operators", len(stored.graph.node), len(expected.graph.node))
    constants, others = _constants(stored), _constants(expected)
    yield from _different(
        "constants", sorted(constants.keys() - others.keys()), sorted(others.keys() - constants.keys())
    )
    yield from _different("number of constants", len(stored.graph.initializer), len(expected.graph.initializer))
    for name in sorted(constants.keys() & others.keys()):
        yield from _constant_differences(name, constants[name], others[name])
    yield from _different("sparse constants", len(stored.graph.sparse_initializer), 0)
    yield from _different("functions", len(stored.functions), 0)


def _other_versions(versions: Mapping[str, str]) -> str | None:
    """The packages whose versions differ from those that wrote the bundle, in words. None if all are equal."""
    installed = library_versions(EXPORTER)
    other = [name for name in EXPORTER if versions.get(name) != installed[name]]
    texts = (f"{name} {versions.get(name, 'unknown')} (installed: {installed[name]})" for name in other)
    return f"the bundle was exported with {', '.join(texts)}" if other else None


def _different(part: str, stored: object, expected: object) -> Iterator[str]:
    if stored != expected:
        yield f"{part}: expected {_short(expected)}; got {_short(stored)}"


def _constant_differences(name: str, stored: NDArray, expected: NDArray) -> Iterator[str]:
    yield from _different(f"type of constant {name!r}", (stored.dtype, stored.shape), (expected.dtype, expected.shape))
    if (stored.dtype, stored.shape) == (expected.dtype, expected.shape):
        wrong = _wrong_numbers(stored, expected)
        if wrong.any():
            place = np.unravel_index(int(wrong.argmax()), wrong.shape)
            yield from _different(
                f"constant {name!r}{[int(i) for i in place]}", str(stored[place]), str(expected[place])
            )


def _wrong_numbers(stored: NDArray, expected: NDArray) -> NDArray[np.bool_]:
    """Where two constants differ: integers exactly, floating-point numbers beyond `CONSTANT_TOLERANCE`."""
    if expected.dtype.kind != "f" or not expected.size:
        return np.asarray(stored != expected)
    limit = CONSTANT_TOLERANCE * np.abs(expected).max()
    # `not <=` instead of `>`, so that a NaN is wrong.
    return ~(np.abs(stored.astype(np.float64) - expected.astype(np.float64)) <= limit)


def _constants(model: onnx.ModelProto) -> dict[str, NDArray]:
    return {tensor.name: numpy_helper.to_array(tensor) for tensor in model.graph.initializer}


def _opsets(model: onnx.ModelProto) -> list[tuple[str, int]]:
    return sorted((each.domain, each.version) for each in model.opset_import)


def _tensors(values: Sequence[ValueInfoProto]) -> list[bytes]:
    return [value.SerializeToString(deterministic=True) for value in values]


def _describe(node: NodeProto) -> str:
    texts = sorted(f"{each.name}={helper.get_attribute_value(each)!r}" for each in node.attribute)
    operator = f"{node.domain}.{node.op_type}" if node.domain else node.op_type
    return f"{operator}({', '.join([*map(repr, node.input), *texts])}) -> {', '.join(map(repr, node.output))}"


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 200 else f"{text[:200]}…"
