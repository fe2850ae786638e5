"""The process that loads and measures one target: requests in on stdin, replies out on stdout, one JSON per line.

Each target runs in a separate process. Its peak memory and loading time then include nothing else, and the thread
pools of the libraries do not disturb each other. A process ends when stdin is closed.
"""

import json
import pickle
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ...runtime.bundle.manifest import Manifest, read_manifest
from ...runtime.errors import DuoSpaceNetError
from ...runtime.frame import Frame
from ...runtime.peak_memory import peak_memory_gb
from ...runtime.versions import library_versions
from ..error_reply import error_reply
from ..private_stdout import private_stdout
from .frame_cycle import FrameCycle
from .peer_model import build_peer_model
from .runners import BundleRunner, Runner, Throughput, measure_first_frame, measure_frames
from .stateless_runners import GraphNetwork, StatelessRunner, TorchNetwork
from .targets import Target

NUM_WARM_UP = 2  # frames after the window is full; runs of a new size may still allocate memory


def main() -> None:
    """Answer requests until stdin is closed."""
    with private_stdout() as replies:
        worker = Worker(Target.model_validate_json(sys.stdin.readline()))
        for line in sys.stdin:
            json.dump(_answer(worker, json.loads(line)), replies)
            replies.write("\n")
            replies.flush()


class Worker:
    """A target in this process. Each public method answers a request."""

    def __init__(self, target: Target) -> None:
        self._target = target
        self._manifest = read_manifest(target.bundle)
        self._decoded: list[Frame] = []
        self._runner: Runner | None = None
        self._throughput: Throughput | None = None

    def load(self) -> dict[str, Any]:
        """Load the target, fill its window, and run the warm-up."""
        self._frames = self._new_cycle()
        start_s = time.perf_counter()
        self._runner = runner = load_runner(self._target, self._manifest)
        load_s = time.perf_counter() - start_s
        rows = measure_frames(runner, self._frames, runner.window + NUM_WARM_UP)
        return {
            "load_s": load_s,
            "first_frame_s": rows[0]["frame"],
            "window": runner.window,
            "versions": library_versions(["duospacenet", "numpy", "opencv", *self._libraries()]),
        }

    def measure(self, count: int) -> list[dict[str, float]]:
        """Measure frames with a full window: durations [s] by stage."""
        assert self._runner is not None, "load comes first"
        return measure_frames(self._runner, self._frames, count)

    def measure_first_frame(self) -> float:
        """Measure the first frame after a reset [s], then fill the window again."""
        assert self._runner is not None, "load comes first"
        return measure_first_frame(self._runner, self._frames)

    def measure_throughput(self, streams: int, duration_s: float) -> dict[str, float]:
        """Measure several streams in threads."""
        assert isinstance(self._runner, BundleRunner), "only a bundle has streams"
        if self._throughput is None:
            self._throughput = Throughput(self._runner, self._new_cycle)
        frames, seconds = self._throughput.measure(streams, duration_s)
        return {"frames": frames, "seconds": seconds}

    def peak_memory_gb(self) -> float:
        """The peak memory of this process so far."""
        return peak_memory_gb()

    def export_stateless(self, path: str, dcn: str) -> dict[str, Any]:
        """Write the stateless ONNX graph of the bundle's model, in its operator set; returns its description."""
        from ...export.operator_forms import OperatorForms
        from ...export.stateless import export_stateless

        model = build_peer_model(self._target.bundle, self._manifest, self._target.weights)
        opset = OperatorForms.of(self._manifest).opset
        return export_stateless(model, Path(path), dcn, opset).model_dump(mode="json")  # type: ignore[arg-type]

    def profile(self, count: int) -> list[dict[str, Any]]:
        """Profile the operators of a bundle's graphs over `count` frames with a full window."""
        from .operator_profile import profile_operators

        frames = self._new_cycle()
        records = profile_operators(self._target.bundle, self._manifest, self._target.threads, frames, count)
        return [record.model_dump(mode="json") for record in records]

    def _new_cycle(self) -> FrameCycle:
        assert self._target.frames is not None, "the benchmark has decoded the frames"
        if not self._decoded:
            # The benchmark has written this file a moment ago, in a folder that only this user can read.
            with self._target.frames.open("rb") as file:
                self._decoded = pickle.load(file)
        return FrameCycle(self._decoded, self._manifest.window.nominal_time_delta_s)

    def _libraries(self) -> list[str]:
        if self._target.kind in ("eager", "compile"):
            return ["torch"]
        return ["openvino" if self._target.kind == "openvino" else self._target.engine]


def load_runner(target: Target, manifest: Manifest) -> Runner:
    """Load a target. Raises ArtifactError for files that are not valid."""
    if target.kind == "bundle":
        return BundleRunner.load(target.bundle, target.threads, target.engine, target.engine_precision)
    if target.kind in ("eager", "compile"):
        model = build_peer_model(target.bundle, manifest, target.weights)
        return StatelessRunner(manifest, TorchNetwork(model, target.threads, compiled=target.kind == "compile"))
    assert target.graph is not None and target.graph_spec is not None, "the benchmark has exported the graph"
    engine = "openvino" if target.kind == "openvino" else "onnxruntime"
    return StatelessRunner(manifest, GraphNetwork(target.graph, target.graph_spec, target.threads, engine))


def _answer(worker: Worker, request: dict[str, Any]) -> dict[str, Any]:
    """Call the method that a request names. Errors of a user are part of the reply; others end the process."""
    method: Callable[..., Any] = getattr(worker, request.pop("method"))
    try:
        return {"result": method(**request)}
    except DuoSpaceNetError as error:
        return error_reply(error)


if __name__ == "__main__":
    main()
