"""Reports of benchmarks, written by hand."""

from collections.abc import Mapping
from typing import Any

from duospacenet.jobs.benchmarking.bench_report import BenchReport
from duospacenet.runtime.cpu import read_cpu

STAGES_MS = {"preprocess": 2.0, "projector": 0.5, "backbone": 60.0, "lifter": 20.0, "decoder": 15.0, "postprocess": 0.5}


def percentiles(p50: float) -> dict[str, Any]:
    return {"p50": p50, "p90": None, "p99": None, "p99_9": None}


def target(stages_ms: Mapping[str, float], frame_ms: float, kind: str = "bundle") -> dict[str, Any]:
    return {
        "kind": kind,
        "description": "by hand",
        "queries": 5,
        "load_s": 0.5,
        "first_frame_ms": 150.0,
        "peak_memory_gb": 0.4,
        "frame_ms": percentiles(frame_ms),
        "stages_ms": {stage: percentiles(ms) for stage, ms in stages_ms.items()},
        "versions": {"numpy": "2.0"},
    }


def report_values(ratios: Mapping[str, float] | None = None, frame_ms: float = 100.0) -> dict[str, Any]:
    """The JSON values of a report of `tiny` on this machine, with two threads.

    ratios: of alternatives, by name. frame_ms: the median frame; the stages are those of `STAGES_MS`.
    """
    cpu, ratios = read_cpu(), ratios or {}
    machine = {"cpu": cpu.model, "instruction_sets": list(cpu.instruction_sets), "cores": 2, "threads": 2}
    machine |= {"affinity": [0, 1], "load_average": 0.1, "system": "Linux"}
    bundle = {"path": "bundle", "preset": "tiny", "precision": "float32", "engine": "onnxruntime"}
    return {
        "kind": "duospacenet bench",
        "schema_version": 1,
        "interrupted": False,
        "machine": machine,
        "bundle": bundle | {"weights": "0" * 64, "sha256": "0" * 64},
        "frames": {"source": "synthetic:3:5", "distinct": 5, "megabytes": 5.8},
        "maps": True,
        "rounds": 1,
        "figures": target(STAGES_MS, frame_ms),
        "host_share": 0.025,
        "cold_start": {"window": 4, "first_frame_ms": 95.0, "full_window_ms": 100.0, "ratio": 1.0526},
        "throughput": [{"streams": 2, "frames": 10, "frames_per_s": 8.0, "peak_memory_gb": 0.5}],
        "alternatives": {
            name: target({"preprocess": 2.0, "model": ratio * frame_ms, "postprocess": 0.5}, ratio * frame_ms, "eager")
            for name, ratio in ratios.items()
        },
        "ratios": {name: {"median": ratio, "q1": ratio, "q3": ratio} for name, ratio in ratios.items()},
        "skipped": {},
        "operators": None,
    }


def report(ratios: Mapping[str, float] | None = None, frame_ms: float = 100.0) -> BenchReport:
    return BenchReport.model_validate(report_values(ratios, frame_ms))
