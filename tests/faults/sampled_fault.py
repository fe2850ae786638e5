"""A structural fault that is sampled at random, and what the samplers share."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnx

from duospacenet.runtime.bundle.manifest import Manifest, TensorSpec
from tests.helpers.bundles import edit_graph

Random = np.random.Generator
Change = Callable[[onnx.ModelProto], None]
Sampled = tuple[str, Callable[[Path], Any]] | None  # a fault's name, and the function that puts it into a bundle folder


def in_graph(name: str, graph: str, change: Change) -> Sampled:
    return name, lambda bundle: edit_graph(bundle, graph, change)


def inputs_of(manifest: Manifest, graph: str) -> tuple[TensorSpec, ...]:
    return manifest.graphs[graph].inputs if graph in manifest.graphs else ()  # type: ignore[index]


def sample_graph(random: Random, manifest: Manifest, bundle: Path, names: Sequence[str]) -> tuple[str, onnx.ModelProto]:
    graph = str(random.choice([name for name in names if name in manifest.graphs]))
    return graph, onnx.load(bundle / f"{graph}.onnx")


def shapes_of(model: onnx.ModelProto) -> dict[str, tuple[int, ...]]:
    values = [*model.graph.input, *model.graph.value_info, *model.graph.output]
    shapes = {value.name: tuple(dim.dim_value for dim in value.type.tensor_type.shape.dim) for value in values}
    return shapes | {tensor.name: tuple(tensor.dims) for tensor in model.graph.initializer}
