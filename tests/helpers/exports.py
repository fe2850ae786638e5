"""Exports that keep or share their traced graphs, and sessions of single graphs."""

import hashlib
import shutil
from pathlib import Path
from unittest import mock

import onnx
import onnxruntime as ort
import torch

from duospacenet.export import bundle, export_bundle, tracing
from duospacenet.export.bisection.search import Trace
from duospacenet.export.graphs import Graph
from duospacenet.model import DuoSpaceNet
from duospacenet.runtime.bundle.manifest import DeformableForm
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.session import set_thread_pool_size


def export_with_traces(model: DuoSpaceNet, out: Path) -> dict[str, Trace]:
    """Export a bundle and return the traces of its graphs by name."""
    traces = {}

    def keep_trace(graph: Graph, path: Path, dcn: DeformableForm) -> torch.export.ExportedProgram:
        program = tracing.trace(graph, path, dcn)
        traces[graph.name] = Trace(program, onnx.load(path))
        return program

    with mock.patch.object(bundle, "trace", keep_trace):
        export_bundle(model, out)
    return traces


class ConversionCache:
    """Converts each distinct traced program to ONNX once, and copies the file when the same program comes again.

    Every graph is still traced. So a configuration that changes a graph, or a weight in it, gives another program and
    a conversion of its own. Use it in place of `tracing.write_onnx`.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._programs: dict[str, torch.export.ExportedProgram] = {}
        self._write_onnx = tracing.write_onnx

    def write_onnx(
        self, program: torch.export.ExportedProgram, graph: Graph, path: Path
    ) -> torch.export.ExportedProgram:
        key = _fingerprint(program, graph)
        file = self._folder / f"{key}.onnx"
        if key not in self._programs:
            self._programs[key] = self._write_onnx(program, graph, file)
        shutil.copy(file, path)
        return self._programs[key]


def session_on_pool(path: Path) -> ort.InferenceSession:
    """A session of one graph on this process's thread pool.

    Once a process has a global pool, onnxruntime refuses sessions with a pool of their own.
    """
    set_thread_pool_size(available_cores())
    options = ort.SessionOptions()
    options.use_per_session_threads = False
    return ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def _fingerprint(program: torch.export.ExportedProgram, graph: Graph) -> str:
    """A hash of everything that the conversion reads: names, operators, shapes, parameters, buffers and constants."""
    digest = hashlib.sha256()
    digest.update(repr((graph.name, list(graph.inputs), list(graph.outputs))).encode())
    digest.update(str(program.graph_signature).encode())
    digest.update(program.graph_module.print_readable(print_output=False, include_stride=True).encode())
    for name, tensor in {**program.state_dict, **program.constants}.items():
        digest.update(f"{name} {tensor.dtype} {tuple(tensor.shape)}".encode())
        digest.update(tensor.detach().contiguous().flatten().view(torch.uint8).numpy())
    return digest.hexdigest()
