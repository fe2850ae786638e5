"""Exports that keep or share their traced graphs, and sessions of single graphs."""

import functools
import hashlib
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

import onnx
import onnxruntime as ort
import torch

from duospacenet.export import bundle, export_bundle, tracing
from duospacenet.export.bisection.search import Trace
from duospacenet.export.graphs import Graph
from duospacenet.export.operator_forms import OperatorForms
from duospacenet.model import DuoSpaceNet
from duospacenet.runtime.cores import available_cores
from duospacenet.runtime.onnxruntime_session import set_thread_pool_size


def export_with_traces(model: DuoSpaceNet, out: Path) -> dict[str, Trace]:
    """Export a bundle and return the traces of its graphs by name."""
    traces = {}

    def keep_trace(graph: Graph, path: Path, forms: OperatorForms) -> torch.export.ExportedProgram:
        program = tracing.trace(graph, path, forms)
        traces[graph.name] = Trace(program, onnx.load(path))
        return program

    with mock.patch.object(bundle, "trace", keep_trace), share_conversions():
        export_bundle(model, out)
    return traces


@contextmanager
def share_conversions() -> Iterator[None]:
    """Convert each distinct traced program to ONNX once per process and opset: most of the time of an export.

    Every graph is still traced. A configuration that changes a graph, or a weight in it, gives another program, which
    is converted. An equal program gets a copy of the file.
    """
    with mock.patch.object(tracing, "write_onnx", _conversion_cache().write_onnx):
        yield


class _ConversionCache:
    def __init__(self, write_onnx: Callable[..., torch.export.ExportedProgram]) -> None:
        self._write_onnx = write_onnx
        self._folder = tempfile.TemporaryDirectory()
        self._programs: dict[str, torch.export.ExportedProgram] = {}

    def write_onnx(
        self, program: torch.export.ExportedProgram, graph: Graph, path: Path, opset: int
    ) -> torch.export.ExportedProgram:
        key = f"{_fingerprint(program, graph)}-{opset}"
        file = Path(self._folder.name) / f"{key}.onnx"
        if key not in self._programs:
            self._programs[key] = self._write_onnx(program, graph, file, opset)
        shutil.copy(file, path)
        return self._programs[key]


@functools.cache
def _conversion_cache() -> _ConversionCache:
    return _ConversionCache(tracing.write_onnx)


def session_on_pool(path: Path) -> ort.InferenceSession:
    """A session of one graph on this process's thread pool.

    Once a process has a global pool, onnxruntime refuses sessions with a pool of their own.
    """
    set_thread_pool_size(available_cores())
    options = ort.SessionOptions()
    options.use_per_session_threads = False
    return ort.InferenceSession(path, options, providers=["CPUExecutionProvider"])


def _fingerprint(program: torch.export.ExportedProgram, graph: Graph) -> str:
    """A hash of the used part of a program: names, operators, shapes, and the values of parameters and buffers.

    A wrapper module holds the whole model, so its program also lists the weights of the other graphs. Those have no
    users.
    """
    digest = hashlib.sha256(repr((graph.name, list(graph.inputs), list(graph.outputs))).encode())
    tensors = {**program.state_dict, **program.constants}
    for spec, node in zip(program.graph_signature.input_specs, program.graph.find_nodes(op="placeholder"), strict=True):
        if node.users:
            digest.update(f"{node.name} {spec.kind} {spec.target} {_describe(node)}".encode())
            if spec.target in tensors:
                digest.update(tensors[spec.target].detach().contiguous().flatten().view(torch.uint8).numpy())
    for node in program.graph.nodes:
        if node.op != "placeholder":
            digest.update(f"{node.name} {node.target} {node.args} {node.kwargs} {_describe(node)}".encode())
    digest.update(str(program.graph_signature.output_specs).encode())
    return digest.hexdigest()


def _describe(node: torch.fx.Node) -> str:
    value = node.meta.get("val")
    return f"{value.dtype} {tuple(value.shape)} {value.stride()}" if isinstance(value, torch.Tensor) else ""
