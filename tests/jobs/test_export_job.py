"""Export and parity as functions: they give what the commands give, and print nothing."""

import json
from pathlib import Path

import pytest

from duospacenet.cli.main import run_app
from duospacenet.jobs import check_bundle_parity, evaluate_bundle, export_model
from duospacenet.model import PRESETS
from duospacenet.runtime.bundle.manifest import read_manifest
from duospacenet.runtime.errors import OutputError, UsageError
from duospacenet.weights import save_checkpoint
from tests.helpers.output_files import contents


def test_the_job_writes_the_same_bundle_as_the_command(reuse_traced_graphs, tmp_path, capfd):
    report = export_model(PRESETS["tiny"], tmp_path / "job", random_weights=True)
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""
    command = ["export", "--preset", "tiny", "--random-weights", "--out", str(tmp_path / "command"), "--json"]
    assert run_app(command) == 0
    assert json.loads(capfd.readouterr().out)["parity"] == report.model_dump(mode="json")
    assert contents(tmp_path / "job") == contents(tmp_path / "command")


def test_a_preset_may_be_given_by_its_name(reuse_traced_graphs, tmp_path):
    export_model("tiny", tmp_path / "bundle", random_weights=True)
    assert read_manifest(tmp_path / "bundle").preset == "tiny"
    with pytest.raises(UsageError, match="got 'tny'"):
        export_model("tny", tmp_path / "other", random_weights=True)


def test_another_form_of_deformable_convolutions_is_refused_for_a_model_without_them(tmp_path):
    with pytest.raises(UsageError, match="--dcn: expected a configuration with deformable convolutions; tiny has none"):
        export_model(PRESETS["tiny"], tmp_path / "bundle", random_weights=True, dcn="grid-sample")
    assert list(tmp_path.iterdir()) == []


def test_the_weights_may_be_given_as_text(tiny_bundle, tiny_model, tmp_path):
    weights = str(tmp_path / "tiny.safetensors")
    save_checkpoint(Path(weights), tiny_model)
    with pytest.raises(OutputError, match="it exists already"):
        export_model(PRESETS["tiny"], str(tiny_bundle), weights=weights)
    assert check_bundle_parity(str(tiny_bundle), weights=weights, sources="synthetic:3:1", retrace=False).report.passed
    scores = evaluate_bundle(str(tiny_bundle), "synthetic:3:1", eager=True, weights=weights)
    assert scores.eager


def test_the_parity_job_returns_what_the_command_prints(tiny_bundle, capfd):
    parity = check_bundle_parity(tiny_bundle, random_weights=True, sources="synthetic:3:1", retrace=False)
    printed = capfd.readouterr()
    assert printed.out == printed.err == ""
    options = ["--random-weights", "--source", "synthetic:3:1", "--no-retrace", "--json"]
    assert run_app(["parity", str(tiny_bundle), *options]) == 0
    assert json.loads(capfd.readouterr().out) == parity.to_dict()
