"""onnxruntime sessions that share one thread pool per process."""

import threading
from collections.abc import Mapping
from pathlib import Path

import onnxruntime as ort

from .bundle.manifest import GraphSpec
from .cores import available_cores, check_thread_count
from .errors import ArtifactError, UsageError
from .session import TensorDescription, Tensors, check_tensors
from .termination import terminable

# onnxruntime's Python module would otherwise print a message and try again when it fails, and it would follow settings
# in the model if an environment variable says so.
_PLAIN = {"enable_fallback": 0, "read_config_from_model": 0}

_DTYPES = {"tensor(float)": "float32", "tensor(uint8)": "uint8", "tensor(bool)": "bool"}

_pool_lock = threading.Lock()
_pool_threads: int | None = None


class OnnxruntimeSession:
    """A graph in onnxruntime; see `session.Session`."""

    precision = "float32"

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
        check_tensors(path, "inputs", _describe(self._session.get_inputs()), spec.inputs)
        check_tensors(path, "outputs", _describe(self._session.get_outputs()), spec.outputs)
        self._path = path
        self._inputs = [tensor.name for tensor in spec.inputs]
        self._outputs = [tensor.name for tensor in spec.outputs]

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        """Run the graph; see `session.Session.run`."""
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


def set_thread_pool_size(threads: int) -> None:
    """Set the size of onnxruntime's global thread pool, which all sessions of the process share.

    Sessions with pools of their own would compete for the same cores. onnxruntime creates the global pool only once.
    Raises UsageError for an impossible number, or if the pool already has another size.
    """
    global _pool_threads
    check_thread_count(threads)
    with _pool_lock:
        if _pool_threads is None:
            ort.set_global_thread_pool_sizes(threads, 1)
            _pool_threads = threads
        elif _pool_threads != threads:
            raise UsageError(
                f"threads: expected {_pool_threads}, the size of this process's thread pool; got {threads}. "
                "Load every pipeline with the same number, or use another process."
            )


def ensure_thread_pool() -> None:
    """Create the global thread pool with the available cores, unless the process has one already."""
    with _pool_lock:
        has_pool = _pool_threads is not None
    if not has_pool:
        set_thread_pool_size(available_cores())


def _describe(tensors: list) -> list[TensorDescription]:
    return [(tensor.name, tuple(tensor.shape), _DTYPES.get(tensor.type, tensor.type)) for tensor in tensors]
