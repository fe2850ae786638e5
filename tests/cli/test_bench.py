"""`duospacenet bench` from end to end."""

import json
import os

import pytest

from duospacenet import jobs
from duospacenet.cli.main import run_app
from duospacenet.jobs.benchmarking.bench_job import (
    DEFAULT_QUERIES,
    DEFAULT_ROUNDS,
    DEFAULT_STREAMS,
    BenchResult,
)
from duospacenet.jobs.benchmarking.bench_report import BenchReport
from duospacenet.jobs.benchmarking.regression import Baseline, compare_reports
from tests.helpers.bench_reports import report, report_values
from tests.helpers.blocked_imports import call_without

SHORT = ["--source", "synthetic:3:3", "--queries", "2", "--rounds", "2", "--streams", "1"]


def test_the_json_of_a_run_can_be_compared_with_the_next_run(tiny_bundle, tmp_path, capfd):
    assert run_app(["bench", str(tiny_bundle), *SHORT, "--json"]) == 0
    printed = capfd.readouterr()
    assert len(printed.out.splitlines()) == 1
    values = json.loads(printed.out, parse_constant=lambda name: pytest.fail(f"{name} in the JSON"))
    assert BenchReport.model_validate(values).figures.queries == 2
    values["figures"]["frame_ms"]["p50"] /= 1000  # a thousand times as fast
    (tmp_path / "old.json").write_text(json.dumps(values))
    compare = ["--compare", str(tmp_path / "old.json"), "--max-regression", "50%"]
    assert run_app(["bench", str(tiny_bundle), *SHORT, *compare]) == 1
    printed = " ".join(capfd.readouterr().out.split())
    assert "frame, median ms" in printed
    assert "slower by more than 50 %" in printed


def test_the_tables_show_every_figure(tiny_bundle, monkeypatch, capfd):
    values = report_values({"eager": 8.0, "out/[red]b": 0.5})
    values["operators"] = [
        {"graph": "decoder", "operator": f"Op{i}", "calls_per_frame": 2.0, "ms_per_frame": 1.5, "share": 0.04}
        for i in range(25)
    ]
    values["skipped"] = {"compile": "no compiler"}
    shown = BenchReport.model_validate(values)
    comparison = compare_reports(Baseline(tiny_bundle / "old.json", report({"eager": 9.0})), shown, 0.1)
    monkeypatch.setattr(jobs, "bench_bundle", lambda *_, **__: BenchResult(shown, comparison), raising=False)
    assert run_app(["bench", str(tiny_bundle)]) == 1
    printed = " ".join(capfd.readouterr().out.split())
    for text in (
        "backbone 60.0 - - - 60.0 %",
        "frame 100.0 - - -",
        "first frame of a stream 95.0 ms, window of 4 frames 100.0 ms, ratio 1.053; pre- and postprocessing 2.5 %",
        "loading 0.50 s, first frame after it 150.0 ms; peak memory 0.40 GB, of which 0.01 GB are the decoded frames",
        "throughput: 2 streams 8.00 frames/s (0.50 GB)",
        "eager 800.0 8.00 8.00 to 8.00 0.50 0.40",
        "out/[red]b 50.0 0.50",
        "decoder Op19 2 1.50 4.0 %",
        "others 5 kinds 7.50 20.0 %",
        "compile was not measured: no compiler",
        "eager / bundle 9 8 +12.5 %",
        "1 figures are slower by more than 10 %",
    ):
        assert text in printed, text


def test_an_interrupted_benchmark_prints_its_rounds_and_ends_with_130(tiny_bundle, monkeypatch, capfd):
    interrupted = BenchReport.model_validate(report_values() | {"interrupted": True})
    monkeypatch.setattr(jobs, "bench_bundle", lambda *_, **__: BenchResult(interrupted, None), raising=False)
    assert run_app(["bench", str(tiny_bundle), "--json"]) == 130
    printed = capfd.readouterr()
    assert json.loads(printed.out)["interrupted"] is True
    assert printed.err == "interrupted\n"


def test_options_reach_the_job(tiny_bundle, monkeypatch):
    calls = {}

    def record(bundle, **options):
        calls.update(options)
        return BenchResult(report(), None)

    monkeypatch.setattr(jobs, "bench_bundle", record, raising=False)
    assert run_app(["bench", str(tiny_bundle), "--json"]) == 0
    assert (calls["queries"], calls["rounds"], calls["streams"]) == (DEFAULT_QUERIES, DEFAULT_ROUNDS, DEFAULT_STREAMS)
    options = [
        "--against",
        "eager,stateless",
        "--against",
        "x",
        "--streams",
        "0",
        "--max-regression",
        "5%",
        "--profile",
    ]
    assert run_app(["bench", str(tiny_bundle), "--json", *options]) == 0
    assert calls["against"] == ["eager,stateless", "x"]
    assert (calls["streams"], calls["max_regression"], calls["profile"]) == ((), 0.05, True)


def test_a_bundle_is_measured_without_torch(tiny_bundle, tmp_path):
    """Neither the command nor the process of the bundle imports it, so it does not count in the memory either."""
    blocked = ("torch", "onnx", "openvino")
    for name in blocked:
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(f"raise AssertionError('imported {name}')")
    environment = os.environ | {"PYTHONPATH": str(tmp_path)}
    done = call_without(blocked, ["bench", tiny_bundle, *SHORT, "--json"], env=environment)
    assert done.returncode == 0, done.stderr
    assert "imported" not in done.stderr
    assert set(json.loads(done.stdout)["figures"]["versions"]) == {"duospacenet", "numpy", "opencv", "onnxruntime"}


REFUSED = {
    "unknown alternative": (["--against", "fast"], 2, "--against: expected eager, compile, stateless, openvino"),
    "no percentage": (["--max-regression", "much"], 2, "--max-regression: expected a percentage"),
    "no streams": (["--streams", "many"], 2, "--streams: expected whole numbers"),
    "no frames": (["--queries", "0"], 2, "--queries"),
    "missing report": (["--compare", "none.json"], 3, "none.json"),
    "missing source": (["--source", "none"], 3, "none"),
    "missing folder of the picture": (["--plot", "none/speed.png"], 5, "no folder none"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_a_wrong_call_ends_with_its_exit_code_and_a_message(tiny_bundle, capfd, case):
    arguments, code, words = REFUSED[case]
    assert run_app(["bench", str(tiny_bundle), *arguments]) == code
    assert words in capfd.readouterr().err
