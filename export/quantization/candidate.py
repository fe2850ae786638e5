"""Candidates: bundles of the same model with different blocks in int8."""

import hashlib
import shutil
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import onnx
from onnxruntime.quantization import TensorsData

from ...runtime import Pipeline
from ...runtime.bundle.manifest import GraphName, Manifest, graph_file_name
from ...runtime.bundle.schema_versions import SCHEMA_VERSION
from ...runtime.onnxruntime_session import OnnxruntimeSession
from ...runtime.session import Session
from .blocks import OPERATORS, blocks_of
from .quantized_graph import quantize_graph
from .simulated_session import SimulatedSession

GraphFiles = Mapping[GraphName, bytes]  # the contents of the quantized graphs; the other graphs stay as they are


class Block(NamedTuple):
    """A block of a graph. nodes: the number of its operators that can be quantized."""

    graph: GraphName
    name: str
    nodes: int


class Candidates:
    """Makes variants of a float32 bundle, in which the chosen blocks are quantized."""

    def __init__(self, bundle: Path, pipeline: Pipeline, ranges: Mapping[GraphName, TensorsData]) -> None:
        """bundle: the float32 bundle. pipeline: it, loaded. ranges: of the calibrated graphs, by graph name."""
        self._bundle, self._pipeline, self._ranges = bundle, pipeline, ranges

    def quantize(self, blocks: Collection[Block]) -> GraphFiles:
        """The graphs that have one of the blocks, with these blocks in int8."""
        chosen = {graph: {block.name for block in blocks if block.graph == graph} for graph in self._ranges}
        return {
            graph: quantize_graph(self._bundle / graph_file_name(graph), self._ranges[graph], names, OPERATORS[graph])
            for graph, names in chosen.items()
            if names
        }

    def engine_pipeline(self, graphs: GraphFiles) -> Pipeline:
        """A pipeline with the quantized graphs in onnxruntime."""
        specs, bundle = self._pipeline.manifest.graphs, self._bundle
        return self._with_sessions(
            {name: OnnxruntimeSession(file, specs[name], bundle / specs[name].file) for name, file in graphs.items()}
        )

    def simulated_pipeline(self, graphs: GraphFiles) -> Pipeline:
        """A pipeline with the quantized graphs, in which all arithmetic is float32."""
        return self._with_sessions({name: SimulatedSession(file) for name, file in graphs.items()})

    def write(self, folder: Path, graphs: GraphFiles) -> Manifest:
        """Write the files of all graphs to `folder`. Returns the manifest, without a parity report."""
        specs = dict(self._pipeline.manifest.graphs)
        for name, spec in specs.items():
            if name in graphs:
                (folder / spec.file).write_bytes(graphs[name])
                specs[name] = spec.model_copy(update={"sha256": hashlib.sha256(graphs[name]).hexdigest()})
            else:
                shutil.copyfile(self._bundle / spec.file, folder / spec.file)
        changes = {"schema_version": SCHEMA_VERSION, "graphs": specs, "parity": None}
        return self._pipeline.manifest.model_copy(update=changes)

    def _with_sessions(self, sessions: Mapping[str, Session]) -> Pipeline:
        return Pipeline(self._pipeline.manifest, {**self._pipeline.sessions, **sessions})


def blocks_in(bundle: Path, manifest: Manifest) -> list[Block]:
    """All blocks of a float32 bundle that can be quantized, in the order of the graphs."""
    return [block for name in OPERATORS if name in manifest.graphs for block in _blocks_in_graph(bundle, name)]


def _blocks_in_graph(bundle: Path, name: GraphName) -> Iterator[Block]:
    blocks = blocks_of(onnx.load_model(bundle / graph_file_name(name)).graph, OPERATORS[name])
    return (Block(name, block, len(nodes)) for block, nodes in blocks.items())
