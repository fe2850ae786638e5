"""The benchmark of a bundle: latency by stage, memory, cold start and throughput, beside alternatives in one run."""

import math
import os
import pickle
import tempfile
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from ...runtime.bundle.manifest import GraphSpec, Manifest, read_manifest
from ...runtime.cores import available_cores
from ...runtime.engine import choose_engine
from ...runtime.errors import INTERRUPTED_EXIT_CODE, CheckError, UsageError
from ...runtime.files import output_errors
from ...runtime.progress import Progress, no_progress
from ..models import optional_path
from ..notify import Notify, ignore
from .bench_options import check_numbers
from .bench_report import BenchReport, OperatorRecord, ThroughputRecord
from .frame_cycle import decode_frames
from .peer_model import find_peer_weights
from .regression import Comparison, check_baseline, compare_reports, read_baseline
from .report_builder import LoadRecord, Measurements, build_report
from .rounds import Turn, run_round
from .targets import GRAPH_PEERS, PEERS, Target, parse_alternatives
from .worker_process import WorkerFailedError, WorkerProcess

BUNDLE = "bundle"  # the name of the bundle among the targets
DEFAULT_QUERIES = 50
DEFAULT_ROUNDS = 10
DEFAULT_STREAMS = (1, 2, 4)
THROUGHPUT_S = 2.5  # duration of a throughput measurement, if two frames per stream take less
PROFILED_FRAMES = 5
MAX_LOAD_PER_CORE = 0.5  # other processes; above it, times are too long


@dataclass(frozen=True)
class BenchResult:
    """The result of a benchmark. comparison: with an earlier report, or None."""

    report: BenchReport
    comparison: Comparison | None

    @property
    def exit_code(self) -> int:
        """The exit code of the command."""
        if self.report.interrupted:
            return INTERRUPTED_EXIT_CODE
        return 0 if self.comparison is None or self.comparison.passed else CheckError.exit_code

    def to_dict(self) -> dict[str, Any]:
        """The report and the comparison as JSON values."""
        comparison = {"comparison": self.comparison.to_dict()} if self.comparison else {}
        return self.report.model_dump(mode="json") | comparison


def bench_bundle(
    bundle: str | Path,
    *,
    source: str | Path | None = None,
    against: Sequence[str] = (),
    weights: str | Path | None = None,
    queries: int = DEFAULT_QUERIES,
    rounds: int = DEFAULT_ROUNDS,
    streams: Sequence[int] = DEFAULT_STREAMS,
    threads: int | None = None,
    engine: str = "onnxruntime",
    engine_precision: str = "float32",
    compare: str | Path | None = None,
    max_regression: float = 0.1,
    profile: bool = False,
    plot: str | Path | None = None,
    check: bool = True,
    progress: Progress = no_progress,
    notify: Notify = ignore,
) -> BenchResult:
    """Measure a bundle and, in the same rounds, its alternatives. Every target runs in a separate process.

    source: frames to repeat; None for synthetic frames of the size of nuScenes' images.
    against: alternatives; see `targets.parse_alternatives`.
    weights: checkpoint for the alternatives that need the model in PyTorch. Random weights have the same speed.
    queries: least number of measured frames of the bundle.
    rounds: number of rounds. In each, the bundle runs its share of `queries`, and an alternative one frame, or as many
        as the bundle if it is a bundle too.
    streams: numbers of streams for the throughput; may be empty.
    threads: of every target; None uses the cores that are available to this process.
    engine, engine_precision: of the bundle; see `Pipeline.load`.
    compare: an earlier report of `--json`. max_regression: the largest share by which a figure may be worse.
    profile: also measure the operators of the graphs.
    plot: a new PNG file for the picture of the report.
    check: refuse calibrations that `check-rig` calls broken.

    An interruption (KeyboardInterrupt) after the first round ends the benchmark. Its report has `interrupted` set; no
    comparison and no picture is made.

    Raises UsageError, InputError for the source or the earlier report, ArtifactError for a bundle or checkpoint,
    MissingExtraError, and CheckError if the bundle's process ends unexpectedly.
    """
    bundle, threads = Path(bundle), available_cores() if threads is None else threads
    check_numbers(queries, rounds, streams, threads, max_regression)
    draw = None if plot is None else _picture_writer(Path(plot))
    chosen = choose_engine(engine, engine_precision)
    if profile and chosen.name != "onnxruntime":
        raise UsageError("--profile: expected --engine onnxruntime, whose profiler it uses. Leave one of them out.")
    manifest = read_manifest(bundle)
    target = Target(
        name=BUNDLE,
        kind="bundle",
        bundle=bundle,
        threads=threads,
        engine=chosen.name,
        engine_precision=chosen.precision,
    )
    alternatives = _with_weights(parse_alternatives(against, target), manifest, optional_path(weights), notify)
    baseline = None if compare is None else read_baseline(Path(compare))
    if baseline:
        check_baseline(baseline, manifest, target, [each.name for each in alternatives], notify)
    load_average = _check_load(notify)
    source_name, frames = decode_frames(source, manifest, check, notify)
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        path = Path(folder) / "frames"
        with output_errors(path), path.open("wb") as file:
            pickle.dump(frames, file, pickle.HIGHEST_PROTOCOL)
        benchmark = _Benchmark(manifest, Path(folder), stack, progress, notify)
        benchmark.load([each.model_copy(update={"frames": path}) for each in (target, *alternatives)])
        measurements = benchmark.measure(queries, rounds, streams, profile, load_average)
    report = build_report(target, manifest, source_name, frames, measurements)
    comparison = compare_reports(baseline, report, max_regression) if baseline and not report.interrupted else None
    if draw and not report.interrupted:
        draw(report)
    return BenchResult(report, comparison)


class _Benchmark:
    """The processes of the targets while they are measured."""

    def __init__(self, manifest: Manifest, folder: Path, stack: ExitStack, progress: Progress, notify: Notify) -> None:
        """folder: for temporary files. stack: ends the processes."""
        self._manifest, self._folder, self._stack = manifest, folder, stack
        self._progress, self._notify = progress, notify
        self._workers: dict[str, WorkerProcess] = {}
        self._loads: dict[str, LoadRecord] = {}
        self._skipped: dict[str, str] = {}

    def load(self, targets: Sequence[Target]) -> None:
        """Load the targets, one after the other. An alternative whose process fails is skipped."""
        for target in self._progress(targets, "load"):
            try:
                if target.kind in GRAPH_PEERS:
                    target = self._with_graph(target)
                worker = self._start(target)
                self._loads[target.name] = LoadRecord(target, worker.call("load"), worker.call("peak_memory_gb"))
                self._workers[target.name] = worker
            except WorkerFailedError as failure:
                self._skip(failure)

    def measure(
        self, queries: int, rounds: int, streams: Sequence[int], profile: bool, load_average: float | None
    ) -> Measurements:
        """Run the rounds, then the throughput and the profile. Stops at an interruption after the first round."""
        rounds = min(rounds, queries)
        frames = math.ceil(queries / rounds)
        turns = {name: self._turn(name, frames) for name in self._workers}
        throughput: list[ThroughputRecord] = []
        operators: list[OperatorRecord] | None = None
        interrupted = False
        try:
            for number in self._progress(range(rounds), "bench"):
                self._run_round(turns, number)
            for name in turns:
                self._loads[name].peak_memory_gb = self._workers[name].call("peak_memory_gb")
            for count in self._progress(sorted(streams), "throughput"):
                throughput.append(self._measure_throughput(count))
            if profile:
                operators = self._profile()
        except KeyboardInterrupt:
            if not len(turns[BUNDLE].samples):
                raise
            interrupted = True
        return Measurements(turns, self._loads, self._skipped, throughput, operators, interrupted, load_average)

    def _turn(self, name: str, frames: int) -> Turn:
        is_stateless = self._loads[name].target.kind in PEERS
        return Turn(self._workers[name], 1 if is_stateless else frames, measures_cold_start=name == BUNDLE)

    def _run_round(self, turns: dict[str, Turn], number: int) -> None:
        """Run a round. If the process of an alternative fails, the round is run again without it."""
        while True:
            try:
                return run_round(list(turns.values()), number)
            except WorkerFailedError as failure:
                self._skip(failure)
                del turns[failure.target]

    def _measure_throughput(self, count: int) -> ThroughputRecord:
        worker = self._workers[BUNDLE]
        result = worker.call("measure_throughput", streams=count, duration_s=THROUGHPUT_S)
        return ThroughputRecord(
            streams=count,
            frames=result["frames"],
            frames_per_s=round(result["frames"] / result["seconds"], 4),
            peak_memory_gb=worker.call("peak_memory_gb"),
        )

    def _profile(self) -> list[OperatorRecord]:
        worker = self._start(self._loads[BUNDLE].target)
        return [OperatorRecord.model_validate(row) for row in worker.call("profile", count=PROFILED_FRAMES)]

    def _with_graph(self, target: Target) -> Target:
        """Export the stateless ONNX graph for a peer, unless the other peer has the same."""
        # OpenVINO has no DeformConv.
        dcn = "grid-sample" if self._manifest.dcn and target.kind == "openvino" else "native"
        same = [each.target for each in self._loads.values() if each.target.graph_dcn == dcn]
        if same:
            return target.model_copy(
                update={"graph": same[0].graph, "graph_spec": same[0].graph_spec, "graph_dcn": dcn}
            )
        self._notify("exporting the stateless graph ...")
        path = self._folder / f"stateless-{dcn}.onnx"
        with WorkerProcess(target, self._folder) as worker:
            spec = GraphSpec.model_validate(worker.call("export_stateless", path=str(path), dcn=dcn))
        return target.model_copy(update={"graph": path, "graph_spec": spec, "graph_dcn": dcn})

    def _start(self, target: Target) -> WorkerProcess:
        return self._stack.enter_context(WorkerProcess(target, self._folder))

    def _skip(self, failure: WorkerFailedError) -> None:
        """Leave out an alternative. Raises CheckError if the bundle itself failed."""
        if failure.target == BUNDLE:
            raise CheckError(f"the bundle cannot be measured: {failure}") from None
        self._skipped[failure.target] = str(failure)
        self._notify(f"warning: {failure.target} is not measured: {failure}")


def _with_weights(
    alternatives: Sequence[Target], manifest: Manifest, weights: Path | None, notify: Notify
) -> list[Target]:
    """The alternatives, with the checkpoint of those that need the model in PyTorch."""
    peers = [each.name for each in alternatives if each.kind in PEERS]
    if not peers:
        if weights is not None:
            raise UsageError(f"--weights: expected only with --against {', '.join(PEERS)}. Leave --weights out.")
        return list(alternatives)
    found = find_peer_weights(manifest, weights)
    if found is None:
        notify(f"{', '.join(peers)}: random weights, which have the same speed")
    return [each.model_copy(update={"weights": found}) if each.name in peers else each for each in alternatives]


def _check_load(notify: Notify) -> float | None:
    """The load average of the last minute; None if unknown. Warns if other processes are using the cores."""
    try:
        load_average = round(os.getloadavg()[0], 2)
    except OSError:
        return None
    if load_average > MAX_LOAD_PER_CORE * available_cores():
        notify(
            f"warning: the load average is {load_average:g} on {available_cores()} cores, so times are too long. "
            "Ratios are more reliable."
        )
    return load_average


def _picture_writer(path: Path) -> Callable[[BenchReport], None]:
    """A function that writes the picture. Raises OutputError if it cannot be written, and MissingExtraError."""
    from .bench_plot import check_picture_path, write_picture

    check_picture_path(path)
    return partial(write_picture, path)
