"""An export that keeps its traces, so that what bisects its bundle need not trace again."""

from pathlib import Path
from unittest import mock

import onnx
import torch

from duospacenet.export import bundle, export_bundle
from duospacenet.export.bisection import Trace
from duospacenet.export.graphs import Graph
from duospacenet.export.tracing import trace
from duospacenet.model import DuoSpaceNet
from duospacenet.runtime.manifest import DeformableForm


def export_with_traces(model: DuoSpaceNet, out: Path) -> dict[str, Trace]:
    """Export a bundle; returns its graphs' traces, by name."""
    traces = {}

    def keep(graph: Graph, path: Path, dcn: DeformableForm) -> torch.export.ExportedProgram:
        program = trace(graph, path, dcn)
        traces[graph.name] = Trace(program, onnx.load(path))
        return program

    with mock.patch.object(bundle, "trace", keep):
        export_bundle(model, out)
    return traces
