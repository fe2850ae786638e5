"""Candidates: bundles of the same model with different blocks in int8."""

import hashlib
import shutil
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import NamedTuple

import onnx
from onnxruntime.quantization import TensorsData

from ...runtime.bundle.manifest import (
    SCHEMA_VERSION,
    GraphName,
    Manifest,
    graph_file_name,
    write_manifest,
)
from .blocks import blocks_of
from .quantized_graph import GRAPHS, quantize_graph


class Block(NamedTuple):
    """A block of a graph. nodes: the number of its operators that can be quantized."""

    graph: GraphName
    name: str
    nodes: int


class Candidates:
    """Makes bundles with the float32 bundle's graphs, in which the chosen blocks are quantized."""

    def __init__(self, bundle: Path, manifest: Manifest, ranges: dict[GraphName, TensorsData]) -> None:
        """bundle, manifest: of the float32 bundle. ranges: of the calibrated graphs, by graph name."""
        self._bundle, self._manifest, self._ranges = bundle, manifest, ranges

    def write(self, folder: Path, blocks: Collection[Block]) -> Manifest:
        """Write the graphs and a manifest without parity report to `folder`. Returns the manifest."""
        graphs = {}
        for name, spec in self._manifest.graphs.items():
            chosen = {block.name for block in blocks if block.graph == name}
            source, target = self._bundle / spec.file, folder / graph_file_name(name)
            if chosen:
                content = quantize_graph(source, self._ranges[name], chosen)
                target.write_bytes(content)
                spec = spec.model_copy(update={"sha256": hashlib.sha256(content).hexdigest()})
            else:
                shutil.copyfile(source, target)
            graphs[name] = spec
        changes = {"schema_version": SCHEMA_VERSION, "graphs": graphs, "parity": None}
        manifest = self._manifest.model_copy(update=changes)
        write_manifest(folder, manifest)
        return manifest


def blocks_in(bundle: Path, manifest: Manifest) -> list[Block]:
    """All blocks of a float32 bundle that can be quantized, in the order of the graphs."""
    return [block for name in GRAPHS if name in manifest.graphs for block in _blocks_in_graph(bundle, name)]


def _blocks_in_graph(bundle: Path, name: GraphName) -> Iterator[Block]:
    blocks = blocks_of(onnx.load_model(bundle / graph_file_name(name)).graph)
    return (Block(name, block, len(nodes)) for block, nodes in blocks.items())
