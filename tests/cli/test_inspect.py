"""`duospacenet inspect`: of a bundle, and the complexity of a preset and of a bundle."""

import json

import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.model import PRESETS
from duospacenet.model.complexity import complexity_by_part
from tests.faults.bench import splice
from tests.helpers.blocked_imports import call_without
from tests.helpers.bundles import edit_graph


def test_a_bundle_is_printed_with_its_parity_report_or_as_its_manifest(tiny_bundle, capfd):
    assert run_app(["inspect", str(tiny_bundle)]) == 0
    printed = capfd.readouterr().out
    for word in ("tiny", "backbone.onnx", "image_T_ego", "slot3.bev_value_1", "relative to RMS", "equal"):
        assert word in printed
    assert run_app(["inspect", str(tiny_bundle), "--json"]) == 0
    assert json.loads(capfd.readouterr().out) == json.loads((tiny_bundle / "manifest.json").read_text())


def test_a_bundle_is_read_without_an_array_or_a_session(tiny_bundle):
    done = call_without(["numpy", "cv2", "onnxruntime", "torch", "duospacenet.model"], ["inspect", tiny_bundle])
    assert (done.returncode, done.stderr) == (0, "")
    assert "backbone.onnx" in done.stdout


def test_verify_runs_the_golden_example_where_pytorch_is_not_installed(tiny_bundle):
    done = call_without(["torch", "onnx", "safetensors"], ["inspect", tiny_bundle, "--verify"], timeout=120)
    assert (done.returncode, "imported" in done.stderr) == (0, False), done.stderr
    assert "example equal in onnxruntime" in done.stdout
    assert "3 frames" in done.stdout


def test_verify_names_the_first_difference_and_ends_with_1(copied_bundle, capfd):
    edit_graph(copied_bundle, "decoder", lambda model: splice(model, "boxes", "Mul", np.float32(1.5)))
    assert run_app(["inspect", str(copied_bundle), "--verify"]) == 1
    printed = " ".join(capfd.readouterr().out.split())
    assert "differs frame 0 (golden-0), decoder.boxes[0, 0]: expected " in printed
    assert "; the tolerance is 0.005, and " in printed
    assert run_app(["inspect", str(copied_bundle), "--verify", "--json"]) == 1
    report = json.loads(capfd.readouterr().out)
    assert (report["passed"], report["frames"]) == (False, 3)
    assert report["difference"].startswith("frame 0 (golden-0), decoder.boxes[0, 0]")


@pytest.mark.parametrize("options", [[], ["--verify"]])
def test_a_damaged_golden_example_ends_with_4(copied_bundle, capfd, options):
    with (copied_bundle / "golden" / "results.jsonl").open("ab") as file:
        file.write(b" ")
    assert run_app(["inspect", str(copied_bundle), *options]) == 4
    assert "golden/results.jsonl: field golden.sha256: expected " in capfd.readouterr().err


def test_the_complexity_of_a_preset_is_a_table_in_millions_and_billions(capfd):
    assert run_app(["inspect", "--preset", "base", "--complexity"]) == 0
    printed = capfd.readouterr()
    rows = {cells[1].strip(): cells[2:5] for line in printed.out.splitlines() if len(cells := line.split("│")) == 6}
    assert list(rows) == ["encoder", "lifter", "FDE", "decoder", "segmentation", "total"]
    parameters, flops, with_sampling = map(float, rows["total"])
    assert parameters == pytest.approx(64.8, rel=0.03)
    assert flops == pytest.approx(1771.7, rel=0.03)
    assert with_sampling > flops
    assert printed.err == ""


def test_json_holds_the_exact_numbers(capfd):
    assert run_app(["inspect", "--preset", "tiny", "--complexity", "--frames", "2", "--json"]) == 0
    printed_counts = json.loads(capfd.readouterr().out)
    assert (printed_counts["preset"], printed_counts["frames"]) == ("tiny", 2)
    expected = complexity_by_part(PRESETS["tiny"], 2)
    assert printed_counts["parts"] == {name: part._asdict() for name, part in expected.items()}


def test_the_complexity_of_a_bundle_is_that_of_its_configuration(tiny_bundle, capfd):
    assert run_app(["inspect", str(tiny_bundle), "--complexity", "--json"]) == 0
    assert run_app(["inspect", "--preset", "tiny", "--complexity", "--json"]) == 0
    bundle_counts, preset_counts = map(json.loads, capfd.readouterr().out.splitlines())
    assert bundle_counts == preset_counts


USAGE = {
    "neither": ([], "expected either BUNDLE, or --preset or --config"),
    "both": (["bundle", "--preset", "tiny", "--complexity"], "expected either BUNDLE, or --preset or --config"),
    "a preset alone": (["--preset", "tiny"], "--preset: expected with --complexity"),
    "verify without a bundle": (["--preset", "tiny", "--complexity", "--verify"], "--verify: expected with a bundle"),
    "verify and complexity": (["bundle", "--complexity", "--verify"], "--verify: expected with a bundle"),
    "no such preset": (["--preset", "huge", "--complexity"], "--preset: expected one of"),
    "no frames": (["--preset", "tiny", "--complexity", "--frames", "0"], "--frames"),
}


@pytest.mark.parametrize("call", USAGE)
def test_a_call_that_does_not_name_exactly_one_model_is_refused(capfd, call):
    arguments, words = USAGE[call]
    assert run_app(["inspect", *arguments]) == 2
    printed = capfd.readouterr()
    assert words in printed.err
    assert printed.out == ""
