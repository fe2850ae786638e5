"""The engines: the libraries that can run the graphs of a bundle. A bundle serves all of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal, cast, get_args

from .bundle.bundle_files import read_graphs
from .bundle.manifest import GraphSpec, Manifest
from .cores import available_cores, check_thread_count
from .errors import UsageError
from .onnxruntime_session import OnnxruntimeSession, set_thread_pool_size
from .session import Session
from .versions import library_versions

EngineName = Literal["onnxruntime", "openvino", "onnxruntime-web"]
EnginePrecision = Literal["float32", "default"]

_OPENVINO_PRECISIONS: dict[EnginePrecision, str | None] = {"float32": "f32", "default": None}


@dataclass(frozen=True)
class Engine:
    """A choice of engine.

    name: of the library.
    precision: number format of float operators: "float32", or "default" for the engine's own choice on this CPU.
        onnxruntime always chooses float32.
    """

    name: EngineName = "onnxruntime"
    precision: EnginePrecision = "float32"

    def describe(self, sessions: Mapping[str, Session]) -> dict[str, str]:
        """Name, version, and the precision in which the sessions compute, for reports."""
        session = next(iter(sessions.values()))
        version = getattr(session, "version", None) or library_versions([self.name])[self.name]
        return {"name": self.name, "version": version, "precision": session.precision}


def choose_engine(name: str = "onnxruntime", precision: str = "float32") -> Engine:
    """Check the names of an engine and a precision, and that the engine is installed.

    Raises UsageError for an unknown name. Raises MissingExtraError.
    """
    for option, value, known in (
        ("engine", name, get_args(EngineName)),
        ("engine-precision", precision, get_args(EnginePrecision)),
    ):
        if value not in known:
            *names, last = known
            raise UsageError(f"--{option}: expected {', '.join(names)} or {last}; got {value!r}.")
    if name == "openvino":
        from .openvino_session import OpenvinoSession  # noqa: F401
    if name == "onnxruntime-web":
        from .web_session import check_web_engine

        check_web_engine()
    return Engine(cast(EngineName, name), cast(EnginePrecision, precision))


def open_sessions(bundle: Path, manifest: Manifest, threads: int | None, engine: Engine) -> dict[str, Session]:
    """Check the graph files of a bundle, and open one session per graph, by graph name.

    threads: None for the available cores. onnxruntime has one thread pool of this size per process.
    Raises ArtifactError, MissingExtraError, and UsageError for an impossible number of threads.
    """
    graphs = read_graphs(bundle, manifest)
    open_session = _session_opener(engine, available_cores() if threads is None else threads)
    # pop: the bytes of a graph are released as soon as its session is open.
    return {name: open_session(graphs.pop(name), spec, bundle / spec.file) for name, spec in manifest.graphs.items()}


def _session_opener(engine: Engine, threads: int) -> Callable[[bytes, GraphSpec, Path], Session]:
    if engine.name == "onnxruntime":
        set_thread_pool_size(threads)
        return OnnxruntimeSession
    check_thread_count(threads)
    if engine.name == "onnxruntime-web":
        from .web_session import WebProcess, WebSession

        return partial(WebSession, process=WebProcess(threads))
    from .openvino_session import OpenvinoSession

    return partial(OpenvinoSession, threads=threads, precision=_OPENVINO_PRECISIONS[engine.precision])
