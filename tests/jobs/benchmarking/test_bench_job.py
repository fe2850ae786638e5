"""A benchmark as a whole, on `tiny` and few frames: every target in a process of its own."""

import json
import sys
from pathlib import Path
from typing import ClassVar

import pytest

from duospacenet.jobs import bench_bundle
from duospacenet.jobs.benchmarking import bench_job
from duospacenet.jobs.benchmarking.worker_process import WorkerFailedError, WorkerProcess
from duospacenet.runtime.errors import CheckError, InputError, MissingExtraError, UsageError
from tests.helpers.scene_files import copy_tree

SHORT = {"source": "synthetic:3:3", "queries": 4, "rounds": 2, "streams": ()}


class FakeProcess:
    """Stands for the process of a target. Fails, or is interrupted, at a given call of `measure`."""

    failing: ClassVar[dict[str, tuple[int, BaseException]]] = {}  # by target: number of the call, exception

    def __init__(self, target, folder):
        self.target, self._calls = target, 0

    def __enter__(self):
        return self

    def __exit__(self, *error):
        return None

    def call(self, method, **arguments):
        if method == "load":
            return {"load_s": 0.1, "first_frame_s": 0.2, "window": 4, "versions": {}}
        if method == "measure":
            self._calls += 1
            number, error = self.failing.get(self.target.name, (0, None))
            if error is not None and self._calls == number:
                raise error
            slow = 1.0 if self.target.kind == "bundle" else 5.0
            stages = {"preprocess": 0.01, "decoder": 0.08 * slow, "postprocess": 0.01}
            return [{**stages, "frame": 0.1 * slow}] * arguments["count"]
        return {"measure_first_frame": 0.08, "peak_memory_gb": 0.5}[method]


@pytest.fixture(autouse=True)
def idle_machine(monkeypatch):
    monkeypatch.setattr(bench_job.os, "getloadavg", lambda: (0.25, 0.0, 0.0))


@pytest.fixture
def fake_processes(monkeypatch):
    monkeypatch.setattr(bench_job, "WorkerProcess", FakeProcess)
    monkeypatch.setattr(FakeProcess, "failing", {})
    return FakeProcess


def test_a_bundle_is_measured_beside_itself(tiny_bundle, tmp_path):
    """The one test of this file with real processes, which also covers throughput and profile."""
    messages = []
    copy_tree(tiny_bundle, tmp_path / "copy")
    options = SHORT | {"streams": (2,), "profile": True, "plot": tmp_path / "speed.png", "threads": 1}
    result = bench_bundle(tiny_bundle, against=[str(tmp_path / "copy")], notify=messages.append, **options)
    report = result.report
    assert (report.rounds, report.figures.queries, report.frames.distinct) == (2, 4, 3)
    assert 0.05 < report.ratios[str(tmp_path / "copy")].median < 20
    assert next(iter(report.figures.stages_ms)) == "preprocess"
    assert set(report.figures.stages_ms) >= {"backbone", "lifter", "decoder", "segmenter", "postprocess"}
    assert report.figures.frame_ms.p50 > report.figures.stages_ms["decoder"].p50 > 0
    assert 0 < report.host_share < 1
    assert report.cold_start.window == 4
    assert (report.throughput[0].streams, report.throughput[0].frames >= 4) == (2, True)
    assert report.throughput[0].peak_memory_gb >= report.figures.peak_memory_gb > 0.05
    assert report.operators and {record.graph for record in report.operators} >= {"backbone", "decoder"}
    assert report.machine.threads == 1
    assert set(report.figures.versions) == {"duospacenet", "numpy", "opencv", "onnxruntime"}
    assert messages == []
    assert (tmp_path / "speed.png").stat().st_size > 5000
    json.dumps(result.to_dict(), allow_nan=False)


def test_the_figures_are_those_of_the_processes(tiny_bundle, fake_processes):
    report = bench_bundle(tiny_bundle, against=["eager"], **SHORT).report
    assert report.figures.frame_ms.p50 == 100.0
    assert report.ratios["eager"].median == 5.0
    assert report.host_share == 0.2
    assert (report.cold_start.first_frame_ms, report.cold_start.ratio) == (80.0, 1.25)
    assert report.alternatives["eager"].queries == 2  # one frame per round


@pytest.mark.parametrize("queries, rounds, expected", [(7, 3, 9), (2, 10, 2), (6636, 10, 6640)])
def test_at_least_the_wanted_frames_are_measured(tiny_bundle, fake_processes, queries, rounds, expected):
    options = SHORT | {"queries": queries, "rounds": rounds}
    assert bench_bundle(tiny_bundle, **options).report.figures.queries == expected


def test_an_alternative_that_fails_is_left_out_and_its_round_is_run_again(tiny_bundle, fake_processes):
    fake_processes.failing = {"compile": (2, WorkerFailedError("compile", "no compiler"))}
    messages = []
    report = bench_bundle(tiny_bundle, against=["eager,compile"], notify=messages.append, **SHORT).report
    assert report.skipped == {"compile": "no compiler"}
    assert list(report.alternatives) == ["eager"]
    assert report.rounds == 2
    assert "warning: compile is not measured: no compiler" in messages


def test_a_bundle_whose_process_fails_cannot_be_measured(tiny_bundle, fake_processes):
    fake_processes.failing = {"bundle": (1, WorkerFailedError("bundle", "signal 9"))}
    with pytest.raises(CheckError, match="the bundle cannot be measured: signal 9"):
        bench_bundle(tiny_bundle, **SHORT)


def test_an_interruption_reports_the_completed_rounds(tiny_bundle, fake_processes, tmp_path):
    fake_processes.failing = {"bundle": (3, KeyboardInterrupt())}
    result = bench_bundle(tiny_bundle, plot=tmp_path / "speed.png", **SHORT | {"queries": 20, "rounds": 10})
    assert result.report.interrupted
    assert (result.report.rounds, result.report.figures.queries) == (2, 4)
    assert result.exit_code == 130
    assert not (tmp_path / "speed.png").exists()


def test_an_interruption_in_the_first_round_has_no_report(tiny_bundle, fake_processes):
    fake_processes.failing = {"bundle": (1, KeyboardInterrupt())}
    with pytest.raises(KeyboardInterrupt):
        bench_bundle(tiny_bundle, **SHORT)


def test_a_worse_ratio_than_in_an_earlier_report_is_a_regression(tiny_bundle, fake_processes, tmp_path):
    values = bench_bundle(tiny_bundle, against=["eager"], **SHORT).to_dict()
    for old_ratio, exit_code in ((5.4, 0), (5.6, 1)):
        values["ratios"]["eager"]["median"] = old_ratio
        (tmp_path / "old.json").write_text(json.dumps(values))
        result = bench_bundle(tiny_bundle, against=["eager"], compare=tmp_path / "old.json", **SHORT)
        assert result.exit_code == exit_code
        assert result.to_dict()["comparison"]["passed"] == (exit_code == 0)


def test_a_busy_machine_is_mentioned(tiny_bundle, fake_processes, monkeypatch):
    messages = []
    monkeypatch.setattr(bench_job, "available_cores", lambda: 2)
    for load, expected in ((0.9, 0), (3.25, 1)):
        monkeypatch.setattr(bench_job.os, "getloadavg", lambda load=load: (load, 0.0, 0.0))
        report = bench_bundle(tiny_bundle, notify=messages.append, **SHORT).report
        assert report.machine.load_average == load
        assert len(messages) == expected
    assert "the load average is 3.25 on 2 cores" in messages[0]


def test_random_weights_are_mentioned(tiny_bundle, fake_processes):
    messages = []
    bench_bundle(tiny_bundle, against=["eager"], notify=messages.append, **SHORT)
    assert messages == ["eager: random weights, which have the same speed"]


REFUSED = {
    "weights without a peer": ({"weights": "w.safetensors"}, UsageError, "--weights: expected only with --against"),
    "unknown engine": ({"engine": "tensorrt"}, UsageError, "--engine"),
    "unknown peer": ({"against": ["fast"]}, UsageError, "--against"),
    "profile of another engine": ({"engine": "openvino", "profile": True}, UsageError, "--profile"),
    "missing report": ({"compare": "none.json"}, InputError, "no such file"),
    "missing source": ({"source": "none"}, InputError, "none"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_wrong_call_is_refused_before_any_process_starts(tiny_bundle, monkeypatch, case):
    options, error, words = REFUSED[case]
    if options.get("engine") == "openvino":
        pytest.importorskip("openvino")
    monkeypatch.setattr(bench_job, "WorkerProcess", None)
    with pytest.raises(error, match=words):
        bench_bundle(tiny_bundle, **SHORT | options)


def test_a_picture_without_matplotlib_is_refused_before_the_measurement(tiny_bundle, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib.axes", None)
    monkeypatch.delitem(sys.modules, "duospacenet.jobs.benchmarking.bench_plot", raising=False)
    with pytest.raises(MissingExtraError, match="'viz'"):
        bench_bundle(tiny_bundle, plot=tmp_path / "speed.png", **SHORT)


def test_processes_end_with_the_benchmark(tiny_bundle, monkeypatch):
    started = []

    class Recorded(WorkerProcess):
        def __init__(self, target, folder: Path):
            super().__init__(target, folder)
            started.append(self._process)

        def call(self, method, **arguments):
            if method == "measure":
                raise KeyboardInterrupt
            return super().call(method, **arguments)

    monkeypatch.setattr(bench_job, "WorkerProcess", Recorded)
    with pytest.raises(KeyboardInterrupt):
        bench_bundle(tiny_bundle, **SHORT)
    assert [process.returncode for process in started] == [-9]
