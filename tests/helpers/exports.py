"""Exports that keep their traces, so that what bisects a bundle need not trace again; and sessions of single graphs."""

from pathlib import Path
from unittest import mock

import onnx
import onnxruntime as ort
import torch

from duospacenet.export import bundle, export_bundle
from duospacenet.export.bisection.search import Trace
from duospacenet.export.graphs import Graph
from duospacenet.export.tracing import trace
from duospacenet.model import DuoSpaceNet
from duospacenet.runtime.bundle.manifest import DeformableForm
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.session import set_thread_pool_size


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


def session_on_pool(path: Path) -> ort.InferenceSession:
    """A graph on the pool of this process: beside one, onnxruntime allows no session a pool of its own."""
    set_thread_pool_size(available_cores())
    options = ort.SessionOptions()
    options.use_per_session_threads = False
    return ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])
