"""`--engine`: a bundle in OpenVINO by the commands. The engine itself is tested in tests/runtime."""

import json
import sys

import pytest

from duospacenet.cli.main import run_app

DRIVE = "synthetic:5:3"


def run_json(arguments, capfd) -> dict:
    assert run_app([*map(str, arguments), "--json"]) == 0
    return json.loads(capfd.readouterr().out)


def results(out) -> list[dict]:
    return [json.loads(line) for line in (out / "results.jsonl").read_text().splitlines()]


def test_run_writes_the_same_detections_with_both_engines_and_says_which_ran(portable_bundle, tmp_path, capfd):
    summaries = {
        name: run_json(["run", portable_bundle, DRIVE, "--out", tmp_path / name, "--engine", name], capfd)
        for name in ("onnxruntime", "openvino")
    }
    assert summaries["openvino"]["engine"]["name"] == "openvino"
    assert summaries["openvino"]["engine"]["precision"] == "float32"
    for one, other in zip(results(tmp_path / "onnxruntime"), results(tmp_path / "openvino"), strict=True):
        assert len(one["boxes"]) == len(other["boxes"])
        best, other_best = one["boxes"][0], other["boxes"][0]
        assert best["class"] == other_best["class"]
        assert best["score"] == pytest.approx(other_best["score"], abs=1e-5)
        assert best["center_m"] == pytest.approx(other_best["center_m"], abs=1e-3)


def test_a_run_is_not_resumed_with_another_engine_or_precision(portable_bundle, tmp_path, capfd):
    command = ["run", str(portable_bundle), DRIVE, "--out", str(tmp_path / "run")]
    assert run_app([*command, "--engine", "openvino"]) == 0
    for options, message in (
        (["--engine", "onnxruntime"], "the run began with engine 'openvino'; got 'onnxruntime'"),
        (["--engine", "openvino", "--engine-precision", "default"], "engine_precision 'float32'; got 'default'"),
    ):
        capfd.readouterr()
        assert run_app([*command, *options, "--resume"]) == 2
        assert message in capfd.readouterr().err
    assert run_app([*command, "--engine", "openvino", "--resume"]) == 0


def test_eval_reports_the_engine_and_its_precision(portable_bundle, capfd):
    command = ["eval", portable_bundle, DRIVE, "--engine", "openvino", "--engine-precision", "default"]
    engine = run_json(command, capfd)["engine"]
    assert engine["name"] == "openvino"
    assert engine["precision"] in ("float32", "bfloat16", "float16")


def test_parity_compares_the_graphs_and_the_stream_in_openvino(portable_bundle, capfd):
    command = ["parity", portable_bundle, "--random-weights", "--engine", "openvino", "--no-retrace"]
    report = run_json(command, capfd)
    assert report["passed"]
    assert report["engine"] == "openvino"
    assert report["random_inputs"]["decoder"] == 12


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["parity", "--random-weights", "--engine", "openvino", "--bisect"], "--bisect: expected only with --engine"),
        (["eval", DRIVE, "--engine", "openvino", "--eager", "--weights", "none"], "expected only without --eager"),
        (
            ["run", DRIVE, "--out", "none", "--engine", "tensorrt"],
            "--engine: expected onnxruntime, openvino or onnxruntime-web",
        ),
        (["run", DRIVE, "--out", "none", "--engine-precision", "int4"], "--engine-precision: expected float32 or"),
    ],
)
def test_options_that_exclude_each_other_are_refused(portable_bundle, arguments, message, capfd):
    command, *others = arguments
    assert run_app([command, str(portable_bundle), *others]) == 2
    assert message in capfd.readouterr().err


def test_without_openvino_a_run_ends_with_the_command_that_installs_it(portable_bundle, tmp_path, monkeypatch, capfd):
    monkeypatch.delitem(sys.modules, "duospacenet.runtime.openvino_session", raising=False)
    monkeypatch.setitem(sys.modules, "openvino", None)
    command = ["run", str(portable_bundle), DRIVE, "--out", str(tmp_path / "run"), "--engine", "openvino"]
    assert run_app(command) == 6
    assert "pip install 'duospacenet[openvino]'" in capfd.readouterr().err
    assert not (tmp_path / "run").exists()
