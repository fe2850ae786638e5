"""A pipeline whose graphs are the modules of a model in eager mode, without an export."""

import torch

from duospacenet.export.graphs import graphs_to_export
from duospacenet.export.manifest_builder import build_manifest
from duospacenet.model import DuoSpaceNet
from duospacenet.runtime import Pipeline
from duospacenet.runtime.bundle.manifest import WeightsRecord
from duospacenet.runtime.session import to_tensors


class EagerSession:
    """A graph in eager mode; see `runtime.session.Session`."""

    precision = "float32"

    def __init__(self, graph):
        self._graph = graph

    def run(self, tensors):
        outputs = self._graph({name: torch.from_numpy(tensors[name].numpy()) for name in self._graph.inputs})
        return to_tensors(**{name: value.contiguous().numpy().copy() for name, value in outputs.items()})


def eager_pipeline(model: DuoSpaceNet) -> Pipeline:
    """The pipeline of `model`, with the graphs that an export would write."""
    graphs = graphs_to_export(model)
    weights = WeightsRecord(source="random", sha256="0" * 64, trained=False)
    manifest = build_manifest(model.config, weights, graphs, {graph.name: "0" * 64 for graph in graphs})
    return Pipeline(manifest, {graph.name: EagerSession(graph) for graph in graphs})
