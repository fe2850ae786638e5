"""The operators of a bundle's graphs and their time, measured by onnxruntime's profiler."""

import json
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import onnxruntime as ort

from ...runtime import Frame, Pipeline
from ...runtime.bundle.bundle_files import read_graphs
from ...runtime.bundle.manifest import GraphSpec, Manifest
from ...runtime.onnxruntime_session import set_thread_pool_size
from ...runtime.session import Tensors
from .bench_report import OperatorRecord
from .runners import BundleRunner, measure_frames

_RUN = "model_run"  # the profiler's event of a whole run of a graph


def profile_operators(
    bundle: Path, manifest: Manifest, threads: int, frames: Iterator[Frame], count: int
) -> list[OperatorRecord]:
    """Profile `count` frames with a full window, in onnxruntime. Returns the operators, the slowest first.

    Raises ArtifactError for a bundle that is not valid.
    """
    graphs = read_graphs(bundle, manifest)
    set_thread_pool_size(threads)
    with tempfile.TemporaryDirectory() as folder:
        sessions: dict[str, ProfiledSession] = {
            name: ProfiledSession(graphs.pop(name), spec, Path(folder) / name) for name, spec in manifest.graphs.items()
        }
        runner = BundleRunner(Pipeline(manifest, sessions))
        measure_frames(runner, frames, runner.window)
        warm_up = {name: session.num_runs for name, session in sessions.items()}
        measure_frames(runner, frames, count)
        events = {name: session.end() for name, session in sessions.items()}
    return sum_by_operator({name: skip_runs(events[name], warm_up[name]) for name in events}, count)


def sum_by_operator(events: Mapping[str, Sequence[dict[str, Any]]], num_frames: int) -> list[OperatorRecord]:
    """The time of each kind of operator in each graph, the slowest first. events: the profiler's, by graph."""
    calls: Counter[tuple[str, str]] = Counter()
    microseconds: Counter[tuple[str, str]] = Counter()
    for graph, graph_events in events.items():
        for event in graph_events:
            if event.get("cat") == "Node" and event["name"].endswith("_kernel_time"):
                key = graph, event["args"]["op_name"]
                calls[key] += 1
                microseconds[key] += event["dur"]
    total = sum(microseconds.values())
    return [
        OperatorRecord(
            graph=graph,
            operator=operator,
            calls_per_frame=round(calls[graph, operator] / num_frames, 2),
            ms_per_frame=round(duration / 1000 / num_frames, 4),
            share=round(duration / total, 4),
        )
        for (graph, operator), duration in microseconds.most_common()
    ]


def skip_runs(events: Sequence[dict[str, Any]], num_runs: int) -> list[dict[str, Any]]:
    """The events after the first `num_runs` runs of a graph."""
    ends = sorted(event["ts"] + event["dur"] for event in events if event["name"] == _RUN)
    start = ends[num_runs - 1] if num_runs else 0
    return [event for event in events if event["ts"] >= start]


class ProfiledSession:
    """A graph in onnxruntime with its profiler; see `runtime.session.Session`."""

    precision = "float32"

    def __init__(self, graph: bytes, spec: GraphSpec, prefix: Path) -> None:
        """prefix: start of the path of the profile, which onnxruntime writes."""
        options = ort.SessionOptions()
        options.use_per_session_threads = False  # the process's thread pool, as in the runtime
        options.log_severity_level = 4
        options.enable_profiling = True
        options.profile_file_prefix = str(prefix)
        self._session = ort.InferenceSession(graph, options, providers=["CPUExecutionProvider"])
        self._inputs = [tensor.name for tensor in spec.inputs]
        self._outputs = [tensor.name for tensor in spec.outputs]
        self.num_runs = 0

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        inputs = {name: tensors[name] for name in self._inputs}
        values = self._session.run_with_ort_values(self._outputs, inputs)
        self.num_runs += 1
        return dict(zip(self._outputs, values, strict=True))

    def end(self) -> list[dict[str, Any]]:
        """End the profile and return its events."""
        return json.loads(Path(self._session.end_profiling()).read_bytes())
