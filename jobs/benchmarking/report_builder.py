"""Builds the report of a benchmark from its measurements."""

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...runtime.bundle.manifest import MANIFEST_NAME, Manifest, sha256
from ...runtime.cpu import read_cpu
from ...runtime.frame import Frame
from ...runtime.printable import printable
from .bench_report import (
    HOST_STAGES,
    BenchReport,
    BundleRecord,
    FramesRecord,
    MachineRecord,
    OperatorRecord,
    TargetReport,
    ThroughputRecord,
)
from .rounds import Turn, cold_start, ratio_of_rounds
from .targets import Target, describe_target


@dataclass
class LoadRecord:
    """A loaded target: the reply to `Worker.load`, and the peak memory of its process."""

    target: Target
    reply: dict[str, Any]
    peak_memory_gb: float


@dataclass(frozen=True)
class Measurements:
    """What a benchmark has measured.

    turns, loads: by target, the bundle first. skipped: by target, the reason.
    load_average: of the machine in the minute before.
    """

    turns: Mapping[str, Turn]
    loads: Mapping[str, LoadRecord]
    skipped: Mapping[str, str]
    throughput: Sequence[ThroughputRecord]
    operators: Sequence[OperatorRecord] | None
    interrupted: bool
    load_average: float | None


def build_report(
    target: Target, manifest: Manifest, source: str, frames: Sequence[Frame], measured: Measurements
) -> BenchReport:
    """Build the report. target: the bundle. source, frames: the name of the source, and its decoded frames."""
    turn, load = measured.turns[target.name], measured.loads[target.name]
    # After an interruption in the first round, an alternative may have no samples.
    others = {name: other for name, other in measured.turns.items() if name != target.name and len(other.samples)}
    bundle_medians_s = turn.samples.round_medians_s
    return BenchReport(
        interrupted=measured.interrupted,
        machine=_machine(target.threads, measured.load_average),
        bundle=_bundle(target, manifest),
        frames=_frames(source, frames),
        maps=bool(manifest.map_classes),
        rounds=len(bundle_medians_s),
        figures=_figures(turn, load),
        host_share=_host_share(turn),
        cold_start=cold_start(turn, load.reply["window"]),
        throughput=tuple(measured.throughput),
        alternatives={printable(name): _figures(other, measured.loads[name]) for name, other in others.items()},
        ratios={
            printable(name): ratio_of_rounds(other.samples.round_medians_s, bundle_medians_s)
            for name, other in others.items()
        },
        skipped={printable(name): reason for name, reason in measured.skipped.items()},
        operators=None if measured.operators is None else tuple(measured.operators),
    )


def _machine(threads: int, load_average: float | None) -> MachineRecord:
    cpu = read_cpu()
    return MachineRecord(
        cpu=cpu.model,
        instruction_sets=cpu.instruction_sets,
        cores=cpu.cores,
        threads=threads,
        affinity=cpu.affinity,
        load_average=load_average,
        system=f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
    )


def _bundle(target: Target, manifest: Manifest) -> BundleRecord:
    return BundleRecord(
        path=printable(str(target.bundle)),
        preset=printable(manifest.preset),
        precision=manifest.precision,
        engine=target.engine,
        weights=manifest.weights.sha256,
        sha256=sha256(target.bundle / MANIFEST_NAME),
    )


def _frames(source: str, frames: Sequence[Frame]) -> FramesRecord:
    num_bytes = sum(image.nbytes for frame in frames for image in frame.images.values() if image is not None)
    return FramesRecord(source=printable(source), distinct=len(frames), megabytes=round(num_bytes / 1e6, 1))


def _figures(turn: Turn, load: LoadRecord) -> TargetReport:
    samples = turn.samples
    return TargetReport(
        kind=load.target.kind,
        description=describe_target(load.target),
        queries=len(samples),
        load_s=round(load.reply["load_s"], 4),
        first_frame_ms=round(1000 * load.reply["first_frame_s"], 4),
        peak_memory_gb=round(load.peak_memory_gb, 4),
        frame_ms=samples.percentiles_ms(),
        stages_ms={stage: samples.percentiles_ms(stage) for stage in samples.stages},
        versions=load.reply["versions"],
    )


def _host_share(turn: Turn) -> float:
    """The share of the host's stages in the median frame."""
    host_ms = sum(turn.samples.percentiles_ms(stage).p50 for stage in HOST_STAGES)
    return min(1.0, round(host_ms / turn.samples.percentiles_ms().p50, 4))
