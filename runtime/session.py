"""onnxruntime sessions that share one thread pool per process. Tensors are passed by name and without copies."""

import threading
from collections.abc import Mapping
from pathlib import Path

import onnxruntime as ort
from numpy.typing import NDArray

from .bundle.bundle_files import read_graphs
from .bundle.manifest import MANIFEST_NAME, GraphSpec, Manifest
from .cores import available_cores
from .errors import ArtifactError, UsageError
from .termination import terminable

Tensors = dict[str, ort.OrtValue]

# onnxruntime's Python module would otherwise print a message and try again when it fails, and it would follow settings
# in the model if an environment variable says so.
_PLAIN = {"enable_fallback": 0, "read_config_from_model": 0}

MAX_THREADS = 1024  # onnxruntime creates every thread that it is asked for: 100,000 take more than 16 GB


def to_tensors(**arrays: NDArray) -> Tensors:
    """Wrap arrays as onnxruntime tensors by name. The memory is shared, not copied."""
    return {name: ort.OrtValue.ortvalue_from_numpy(array) for name, array in arrays.items()}


_pool_lock = threading.Lock()
_pool_threads: int | None = None


class Session:
    """One graph, ready to run. Several threads may run it at the same time."""

    def __init__(self, graph: bytes, spec: GraphSpec, path: Path) -> None:
        """Load a graph and compare its inputs and outputs with `spec`.

        graph: the content of its file, which has been checked. path: the file, for messages.
        Raises ArtifactError if onnxruntime rejects the graph, or if a name, shape or dtype differs.
        """
        options = ort.SessionOptions()
        options.use_per_session_threads = False  # use the global pool
        options.log_severity_level = 4  # only fatal errors on stderr; the exception contains the message
        # Without this, onnxruntime reads some bytes as a model in its own format, which was not checked.
        options.add_session_config_entry("session.load_model_format", "ONNX")
        try:
            with terminable(lambda: options.set_load_cancellation_flag(True)):
                self._session = ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"], **_PLAIN)
        except Exception as error:  # onnxruntime has about a dozen exception types, and most are private
            raise ArtifactError(f"{path}: onnxruntime refuses the graph: {error}") from error
        self._session._model_bytes = None  # type: ignore[attr-defined]  # it would keep the bytes in memory
        _check_tensors(path, "inputs", self._session.get_inputs(), spec)
        _check_tensors(path, "outputs", self._session.get_outputs(), spec)
        self._path = path
        self._inputs = [tensor.name for tensor in spec.inputs]
        self._outputs = [tensor.name for tensor in spec.outputs]

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        """Run the graph and return its outputs by name, as new tensors.

        tensors: must contain the graph's inputs by name; other tensors are ignored. Inputs are used without a copy.

        Raises ArtifactError if the graph fails. The inputs have been validated before, so the graph is at fault.
        Raises KeyboardInterrupt if `termination.terminate_calls` ends the run.
        """
        binding = self._session.io_binding()
        for name in self._inputs:
            binding.bind_ortvalue_input(name, tensors[name])
        for name in self._outputs:
            binding.bind_output(name)
        options = ort.RunOptions()
        try:
            with terminable(lambda: setattr(options, "terminate", True)):
                self._session.run_with_iobinding(binding, options)
        except Exception as error:  # see __init__
            raise ArtifactError(f"{self._path}: the graph failed to run: {error}") from error
        return dict(zip(self._outputs, binding.get_outputs(), strict=True))


def open_sessions(bundle: Path, manifest: Manifest, threads: int | None) -> dict[str, Session]:
    """Check the graph files of a bundle, and open one session per graph, by graph name.

    threads: size of the process's thread pool; None for the available cores.
    Raises ArtifactError, and UsageError as `set_thread_pool_size`.
    """
    graphs = read_graphs(bundle, manifest)
    set_thread_pool_size(available_cores() if threads is None else threads)
    # pop: the bytes of a graph are released as soon as its session is open.
    return {name: Session(graphs.pop(name), spec, bundle / spec.file) for name, spec in manifest.graphs.items()}


def set_thread_pool_size(threads: int) -> None:
    """Set the size of onnxruntime's global thread pool, which all sessions of the process share.

    Sessions with pools of their own would compete for the same cores. onnxruntime creates the global pool only once.
    Raises UsageError for a number outside 1 to MAX_THREADS, or if the pool already has another size.
    """
    global _pool_threads
    if not 1 <= threads <= MAX_THREADS:
        raise UsageError(f"threads: expected 1 to {MAX_THREADS}; got {threads}.")
    with _pool_lock:
        if _pool_threads is None:
            ort.set_global_thread_pool_sizes(threads, 1)
            _pool_threads = threads
        elif _pool_threads != threads:
            raise UsageError(
                f"threads: expected {_pool_threads}, the size of this process's thread pool; got {threads}. "
                "Load every pipeline with the same number, or use another process."
            )


def _check_tensors(path: Path, side: str, actual: list, spec: GraphSpec) -> None:
    dtypes = {"tensor(float)": "float32", "tensor(uint8)": "uint8", "tensor(bool)": "bool"}
    got = [(tensor.name, tuple(tensor.shape), dtypes.get(tensor.type, tensor.type)) for tensor in actual]
    expected = [(tensor.name, tensor.shape, tensor.dtype) for tensor in getattr(spec, side)]
    for want, have in zip(expected, got, strict=False):
        if want != have:
            raise ArtifactError(f"{path}: {side}: {MANIFEST_NAME} says {want}; the graph has {have}. Export again.")
    if len(expected) != len(got):
        raise ArtifactError(f"{path}: {side}: {MANIFEST_NAME} lists {len(expected)}; the graph has {len(got)}.")
