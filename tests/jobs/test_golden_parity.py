"""Parity against a golden file: without PyTorch, in other engines, and of outputs that were computed elsewhere."""

import hashlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from duospacenet.cli.main import run_app
from duospacenet.export.parity.golden_writer import write_golden_file
from duospacenet.jobs.export_job import export_model
from duospacenet.jobs.golden_parity import check_golden_parity
from duospacenet.model import randomise
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.errors import ArtifactError, InputError, OutputError, UsageError
from duospacenet.runtime.parity.golden_file import GoldenFile
from tests.faults.bench import splice
from tests.helpers.blocked_imports import call_without
from tests.helpers.bundles import edit_graph
from tests.helpers.parity_results import passing_result

PAGE = Path(__file__).parents[2] / "docs" / "parity.md"
PYTORCH = ["torch", "onnx", "onnxscript", "onnx_ir", "safetensors"]


@pytest.fixture(scope="module")
def golden(tiny_model, tmp_path_factory):
    """The golden file of `tiny_model`."""
    path = tmp_path_factory.mktemp("golden") / "golden.npz"
    write_golden_file(path, tiny_model)
    return path


@pytest.fixture(scope="module")
def log(golden, tiny_bundle, tmp_path_factory):
    """The outputs of all cases, made by the script in docs/parity.md, which shares no code with the toolkit."""
    folder = tmp_path_factory.mktemp("foreign")
    (folder / "bundle").symlink_to(tiny_bundle)
    (folder / "golden.npz").symlink_to(golden)
    (script,) = re.findall(r"^```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    subprocess.run([sys.executable, "-c", script], cwd=folder, check=True, timeout=300)
    return dict(np.load(folder / "log.npz"))


def save(path, outputs):
    np.savez(path, **outputs)
    return path


def test_a_bundle_is_proven_where_pytorch_is_not_installed(tiny_bundle, golden):
    done = call_without(PYTORCH, ["parity", tiny_bundle, "--golden", golden, "--json"], timeout=300)
    assert (done.returncode, "imported" in done.stderr) == (0, False), done.stderr
    report = json.loads(done.stdout)
    assert report["passed"]
    assert set(report["graphs"]) == {"projector", "backbone", "lifter", "decoder", "segmenter"}
    assert report["random_inputs"] == dict.fromkeys(report["graphs"], 2)
    assert [frame["window"] for frame in report["stream"]] == [1, 2, 3, 4, 4, 0, 4, 4, 4, 1, 2, 1, 1, 1]


def test_two_golden_files_of_a_model_are_equal_and_hold_each_array_once(tiny_model, golden, tmp_path):
    write_golden_file(tmp_path / "again.npz", tiny_model)
    assert (tmp_path / "again.npz").read_bytes() == golden.read_bytes()
    arrays = np.load(golden)
    hashes = {hashlib.sha256(arrays[name].tobytes() + str(arrays[name].shape).encode()).digest() for name in arrays}
    assert len(hashes) == len(arrays.files)


def test_the_golden_file_has_the_lengths_of_the_heading_vectors_where_there_are_boxes(tiny_bundle, golden):
    manifest = read_manifest(tiny_bundle)
    with GoldenFile(golden) as file:
        for case in file.cases:
            assert (case.heading is not None) == (case.graph == "decoder")
        for index, frame in enumerate(file.about.stream):
            lengths = file.frame(index, manifest).heading
            assert (lengths is None) == (frame.window == 0)
            assert lengths is None or lengths.shape == file.frame(index, manifest).outputs["boxes"].shape[:1]


@pytest.mark.parametrize(("factor", "passes"), [(0.9, True), (1.1, False)])
def test_the_yaw_error_of_a_short_heading_vector_counts_by_its_length(
    tiny_bundle, golden, log, tmp_path, factor, passes
):
    """The shortest vector of a case turns by more than the tolerance, but moves by `factor` times the tolerance."""
    arrays = np.load(golden)
    about = json.loads(arrays["about"].item())
    case = next(case for case in about["cases"] if case["graph"] == "decoder" and case["seed"] is None)
    boxes, lengths = arrays[case["outputs"]["boxes"]], arrays[case["heading"]]
    query = int(lengths.argmin())
    assert lengths[query] < 0.8
    turned = boxes.astype(np.float32)
    turned[query, 6] += factor * 1e-4 * np.sqrt(np.mean(np.square(boxes[:, 6], dtype=np.float64))) / lengths[query]
    path = save(tmp_path / "log.npz", log | {f"{case['name']}/boxes": turned})
    assert check_golden_parity(tiny_bundle, golden, engine_log=path).report.passed == passes


def test_openvino_is_compared_with_the_golden_file(portable_bundle, golden):
    pytest.importorskip("openvino")
    result = check_golden_parity(portable_bundle, golden, engine="openvino")
    assert (result.report.passed, result.engine) == (True, "openvino")


def test_an_int8_bundle_has_the_tolerances_of_int8(tiny_int8_bundle, golden):
    report = check_golden_parity(tiny_int8_bundle, golden).report
    assert report.passed
    assert report.graphs["backbone"]["reduced_pv_0"].quantized
    assert not report.graphs["decoder"]["boxes"].quantized
    assert "backbone" not in report.random_inputs


def test_a_wrong_graph_is_found(copied_bundle, golden, capfd):
    edit_graph(copied_bundle, "decoder", lambda model: splice(model, "boxes", "Mul", np.float32(1.01)))
    assert run_app(["parity", str(copied_bundle), "--golden", str(golden)]) == 1
    printed = " ".join(capfd.readouterr().out.split())
    assert "differs decoder.boxes, " in printed
    assert "differs stream, frame 0: box error" in printed


def test_the_golden_file_of_other_weights_is_refused(tiny_bundle, tiny_model, tmp_path):
    from copy import deepcopy

    write_golden_file(tmp_path / "other.npz", randomise(deepcopy(tiny_model), 1))
    with pytest.raises(ArtifactError, match=r"other\.npz: expected the weights of .*; got "):
        check_golden_parity(tiny_bundle, tmp_path / "other.npz")


def test_a_golden_file_with_a_graph_that_the_bundle_lacks_is_refused(tiny_bundle, golden):
    manifest = read_manifest(tiny_bundle)
    graphs = {name: spec for name, spec in manifest.graphs.items() if name != "segmenter"}
    with GoldenFile(golden) as file, pytest.raises(ArtifactError, match=r"golden\.npz: .* a graph 'segmenter'"):
        file.check_model(tiny_bundle, manifest.model_copy(update={"graphs": graphs}))


@pytest.mark.parametrize("fraction", [0.0, 0.3, 0.999])
def test_a_half_written_golden_file_is_refused(tiny_bundle, golden, tmp_path, fraction):
    content = golden.read_bytes()
    (tmp_path / "half.npz").write_bytes(content[: int(fraction * len(content))])
    with pytest.raises(ArtifactError, match=r"half\.npz: expected a whole NPZ archive"):
        check_golden_parity(tiny_bundle, tmp_path / "half.npz")


def test_a_flipped_bit_in_a_golden_file_is_refused(tiny_bundle, golden, tmp_path):
    content = bytearray(golden.read_bytes())
    content[len(content) // 3] ^= 1
    (tmp_path / "flipped.npz").write_bytes(content)
    with pytest.raises(ArtifactError, match=r"flipped\.npz: array .*cannot be read"):
        check_golden_parity(tiny_bundle, tmp_path / "flipped.npz")


# --- Engine logs -----------------------------------------------------------------------------------------------------


def test_the_outputs_of_another_engine_are_compared(tiny_bundle, golden, log, tmp_path, capfd):
    path = save(tmp_path / "log.npz", log)
    assert run_app(["parity", str(tiny_bundle), "--golden", str(golden), "--engine-log", str(path)]) == 0
    assert "outputs in log.npz" in " ".join(capfd.readouterr().out.split())
    wrong = log | {"decoder/random-2/boxes": log["decoder/random-2/boxes"][::-1]}
    save(path, wrong)
    assert run_app(["parity", str(tiny_bundle), "--golden", str(golden), "--engine-log", str(path)]) == 1
    assert "differs decoder.boxes, random input 2: relative error" in " ".join(capfd.readouterr().out.split())


def test_a_nan_of_another_engine_is_a_difference(tiny_bundle, golden, log, tmp_path):
    boxes = log["decoder/frame-3/boxes"].copy()
    boxes[0, 0] = np.nan
    path = save(tmp_path / "log.npz", log | {"decoder/frame-3/boxes": boxes})
    report = check_golden_parity(tiny_bundle, golden, engine_log=path).report
    assert report.failures == ("decoder.boxes, frame 3: not all numbers are finite",)


def to_json(log, golden, tensors):
    values = {
        name: {"shape": value.shape, "dtype": value.dtype.name, "values": value.ravel().tolist()}
        for name, value in log.items()
        if value.ndim
    }
    return json.dumps({"golden_sha256": str(log["golden_sha256"]), "outputs": values | tensors})


def test_a_log_can_be_json_with_null_for_nan(tiny_bundle, golden, log, tmp_path):
    path = tmp_path / "log.json"
    boxes = log["decoder/frame-3/boxes"]
    with_nan = {"shape": boxes.shape, "dtype": "float32", "values": [None, *boxes.ravel()[1:].tolist()]}
    path.write_text(to_json(log, golden, {"decoder/frame-3/boxes": with_nan}))
    report = check_golden_parity(tiny_bundle, golden, engine_log=path).report
    assert report.failures == ("decoder.boxes, frame 3: not all numbers are finite",)
    short = with_nan | {"values": [1.0]}
    path.write_text(to_json(log, golden, {"decoder/frame-3/boxes": short}))
    with pytest.raises(
        InputError, match=r"outputs\.decoder/frame-3/boxes: expected float32 \(32, 9\); got .* 1 values"
    ):
        check_golden_parity(tiny_bundle, golden, engine_log=path)


NAME = "decoder/frame-3/boxes"
WRONG_LOGS = {
    "another golden file": (
        lambda log: log | {"golden_sha256": np.array("0" * 64)},
        "golden_sha256: expected .* the hash of .*golden.npz; got '000000000000'",
    ),
    "no hash": (lambda log: {k: v for k, v in log.items() if k != "golden_sha256"}, "'golden_sha256'; it is missing"),
    "a missing case": (
        lambda log: {k: v for k, v in log.items() if not k.startswith("lifter/random-0")},
        "outputs of all cases .* are missing, the first 'lifter/random-0/bev'",
    ),
    "a further output": (
        lambda log: log | {"decoder/frame-3/scores": log[NAME]},
        "others, the first 'decoder/frame-3/s",
    ),
    "a wrong shape": (
        lambda log: log | {NAME: log[NAME].T},
        r"array 'decoder/frame-3/boxes': expected float32 \(32, 9\); got float32 \(9, 32\)",
    ),
    "a larger array": (lambda log: log | {NAME: np.zeros((10_000, 9))}, "expected at most .* bytes; got 720128"),
    "a wrong type": (
        lambda log: log | {NAME: log[NAME].astype(np.float16)},
        r"expected float32 \(32, 9\); got float16 \(32, 9\)",
    ),
    "pickled objects": (lambda log: log | {NAME: np.array([{}])}, "cannot be read"),
    "control characters": (lambda log: log | {"a\x1b[31m": log[NAME]}, r"the first 'a\\x1b\[31m'"),
}


@pytest.mark.parametrize("kind", WRONG_LOGS)
def test_a_log_that_does_not_fit_is_refused(tiny_bundle, golden, log, tmp_path, kind):
    change, message = WRONG_LOGS[kind]
    path = save(tmp_path / "log.npz", change(dict(log)))
    with pytest.raises(InputError, match=message):
        check_golden_parity(tiny_bundle, golden, engine_log=path)


def test_a_half_written_log_is_refused(tiny_bundle, golden, log, tmp_path):
    path = save(tmp_path / "log.npz", log)
    path.write_bytes(path.read_bytes()[:-200])
    with pytest.raises(InputError, match=r"log\.npz: expected a whole NPZ archive"):
        check_golden_parity(tiny_bundle, golden, engine_log=path)
    with pytest.raises(InputError, match="expected a file; got no such file"):
        check_golden_parity(tiny_bundle, golden, engine_log=tmp_path / "absent.npz")


# --- Command line ----------------------------------------------------------------------------------------------------


def test_options_that_only_a_comparison_with_pytorch_takes_are_refused(tiny_bundle, golden, capfd):
    for options, words in (
        (["--golden", str(golden), "--random-weights"], "--golden: expected without --random-weights"),
        (["--golden", str(golden), "--source", "synthetic:1:1"], "--golden: expected without --source"),
        (["--golden", str(golden), "--no-retrace"], "--golden: expected without --no-retrace"),
        (["--golden", str(golden), "--random-inputs", "3"], "--golden: expected without --random-inputs"),
        (["--engine-log", "log.npz"], "--engine-log: expected with --golden FILE"),
    ):
        assert run_app(["parity", str(tiny_bundle), *options]) == 2
        assert words in " ".join(capfd.readouterr().err.split())


def test_an_export_writes_the_golden_file_beside_the_bundle(golden, tmp_path, monkeypatch):
    def export_nothing(model, out, *options):
        out.mkdir()
        return passing_result()

    monkeypatch.setattr("duospacenet.export.bundle.export_bundle", export_nothing)
    export_model("tiny", tmp_path / "bundle", random_weights=True, golden=tmp_path / "new" / "golden.npz")
    assert (tmp_path / "new" / "golden.npz").read_bytes() == golden.read_bytes()
    shutil.rmtree(tmp_path / "bundle")
    with pytest.raises(OutputError, match=r"golden\.npz: expected a new file"):
        export_model("tiny", tmp_path / "bundle", random_weights=True, golden=tmp_path / "new" / "golden.npz")
    for path in (tmp_path / "bundle" / "golden.npz", tmp_path / "golden.txt"):
        with pytest.raises(UsageError, match=r"expected a file \*\.npz outside the bundle"):
            export_model("tiny", tmp_path / "bundle", random_weights=True, golden=path)
    assert not (tmp_path / "bundle").exists()
