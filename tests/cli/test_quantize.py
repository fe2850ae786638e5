"""`duospacenet quantize` from end to end: what it prints, and its exit codes."""

import io
import json
import re
import shutil
import subprocess
import sys
from contextlib import redirect_stderr, redirect_stdout

import pytest

from duospacenet.cli.main import run_app
from duospacenet.cli.quantization_table import print_quantization
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.bundle.quantization_record import QuantizationRecord
from tests.helpers.golden_manifest import SCHEMA_4
from tests.helpers.processes import start, wait_for


@pytest.fixture(scope="module")
def printed(tiny_bundle, tmp_path_factory):
    """The JSON of a quantization that ends well, and the new bundle."""
    out = tmp_path_factory.mktemp("quantized") / "int8"
    options = ["--out", str(out), "--no-metrics", "--calibration-frames", "1", "--limit", "2", "--json"]
    with redirect_stdout(io.StringIO()) as stdout, redirect_stderr(io.StringIO()) as stderr:
        code = run_app(["quantize", str(tiny_bundle), "--source", "synthetic:5:4", *options])
    assert code == 0, stderr.getvalue()
    return json.loads(stdout.getvalue()), stderr.getvalue(), out


def test_the_json_is_what_the_manifest_holds(printed):
    result, messages, out = printed
    manifest = read_manifest(out)
    assert result["bundle"] == str(out)
    assert result["quantization"] == manifest.quantization.model_dump(mode="json")
    assert result["parity"] == manifest.parity.model_dump(mode="json")
    assert "calibration ..." in messages and "sensitivity ..." in messages


def test_one_source_is_divided_into_calibration_and_comparison(printed):
    record = printed[0]["quantization"]
    assert (record["calibration"]["frames"], record["judging"]["frames"]) == (1, 1)
    assert record["metrics"] is None


def test_inspect_shows_the_precision_and_the_record(printed, capfd):
    assert run_app(["inspect", str(printed[2])]) == 0
    shown = capfd.readouterr().out
    assert re.search(r"^preset +tiny, int8$", shown, re.M)
    assert re.search(r"^calibrated on +1 frames: synthetic:5:4$", shown, re.M)
    assert re.search(r"^int8 blocks +image_encoder\.backbone\.conv1, ", shown, re.M)
    assert "within the tolerances of int8 of the float32 bundle with manifest.json" in " ".join(shown.split())


def test_the_table_has_a_column_for_float32_simulation_and_engine(capfd):
    record = QuantizationRecord.model_validate(SCHEMA_4["quantization"])
    simulated = record.metrics.simulated.model_copy(update={"mAP": 0.5755})
    metrics = record.metrics.model_copy(update={"simulated": simulated})
    print_quantization(record.model_copy(update={"metrics": metrics}))
    rows = {" ".join(line.split()) for line in capfd.readouterr().out.splitlines()}
    assert "float32 simulated engine" in rows
    assert "mAP 0.5765 0.5755 0.5746" in rows
    assert "NDS 0.6477 0.6458 0.6458" in rows
    assert "IoU of drivable_area 0.9000 0.9000 0.9000" in rows
    assert "matched boxes 900 97.00% 97.00%" in rows


def test_without_metrics_the_table_has_the_agreement_only(printed, capfd):
    print_quantization(read_manifest(printed[2]).quantization)
    shown = capfd.readouterr().out
    assert "mAP" not in shown and "distance [m]" in shown


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--out", "OUT"], 2, "Missing option '--source'"),
        (["--source", "synthetic:5:2"], 2, "Missing option '--out'"),
        (["--source", "nowhere", "--out", "OUT"], 3, "nowhere"),
        (["--source", "synthetic:5:1", "--out", "OUT"], 2, "--source: expected at least two frames"),
        (["--source", "synthetic:5:2", "--out", "."], 5, "expected a new folder"),
    ],
)
def test_a_wrong_call_is_refused_before_any_work(tiny_bundle, tmp_path, capfd, arguments, code, message):
    out = tmp_path / "out"
    assert run_app(["quantize", str(tiny_bundle), *(a.replace("OUT", str(out)) for a in arguments)]) == code
    assert message in capfd.readouterr().err
    assert not out.exists()


def test_a_bundle_that_is_no_bundle_is_a_bad_artifact(tmp_path, capfd):
    assert run_app(["quantize", str(tmp_path), "--source", "synthetic:5:2", "--out", str(tmp_path / "out")]) == 4
    assert "expected a bundle folder" in capfd.readouterr().err


def test_bisection_is_for_float32_bundles(printed, capfd):
    assert run_app(["parity", str(printed[2]), "--random-weights", "--bisect"]) == 2
    assert "--bisect: expected a float32 bundle; got int8" in capfd.readouterr().err


def test_the_missing_extra_is_named(tiny_bundle, tmp_path):
    """Quantization needs onnx, which the base installation does not have."""
    code = (
        "import sys; sys.modules['onnx'] = None; from duospacenet.cli.main import run_app; "
        f"sys.exit(run_app(['quantize', {str(tiny_bundle)!r}, '--source', 'synthetic:5:2', '--out', "
        f"{str(tmp_path / 'out')!r}]))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 6, done.stderr
    assert "from the extra 'export'" in done.stderr
    assert not (tmp_path / "out").exists()


def test_an_interrupted_quantization_leaves_nothing_behind(tiny_bundle, tmp_path):
    import signal

    bundle = shutil.copytree(tiny_bundle, tmp_path / "bundle")
    process = start(["quantize", bundle, "--source", "synthetic:5:2000", "--out", tmp_path / "out"])
    wait_for(lambda: list(tmp_path.glob(".out.*")), timeout_s=120)
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=120)
    assert process.returncode == 130
    assert "interrupted" in err and "Traceback" not in err
    assert list(tmp_path.iterdir()) == [bundle]
