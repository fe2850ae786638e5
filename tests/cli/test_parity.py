"""`duospacenet parity` from end to end, with `--bisect` too."""

import json
import shutil

import pytest

from duospacenet.cli.main import run_app
from duospacenet.export.parity import retraced_graphs
from tests.faults.bench import Bench, splice
from tests.faults.bundle_faults import nan_in_a_weight
from tests.helpers.bundles import edit_graph, edit_manifest
from tests.helpers.scene_files import copy_tree

BISECT_ONE_FRAME = ["--random-weights", "--no-retrace", "--source", "synthetic:3:1", "--bisect"]


def test_parity_with_other_weights_ends_with_1(tiny_bundle, capfd):
    source = ["--source", "synthetic:3:2", "--no-retrace", "--json"]
    assert run_app(["parity", str(tiny_bundle), "--random-weights", "--seed", "0", *source]) == 0
    assert json.loads(capfd.readouterr().out)["passed"] is True
    assert run_app(["parity", str(tiny_bundle), "--random-weights", "--seed", "1", *source]) == 1
    printed = capfd.readouterr()
    assert json.loads(printed.out)["passed"] is False
    assert "the bundle was made from other weights" in printed.err


OTHER_CONFIGURATIONS = {
    "another kind of block": (
        lambda config: config["backbone"].update(block="bottleneck"),
        "backbone.block: expected 'basic'",
    ),
    "more heads": (lambda config: config.update(num_heads=8), "num_heads: expected 4; got 8"),
    "more channels": (lambda config: config.update(channels=64), "channels: expected 32; got 64"),
    "more layers": (lambda config: config.update(num_layers=3), "num_layers: expected 2; got 3"),
}


def test_a_configuration_in_the_manifest_that_is_not_the_models_is_a_difference(tiny_bundle, tmp_path, capfd):
    """The reference is built from the preset, so none of these configurations is used."""
    copy_tree(tiny_bundle, tmp_path / "bundle")
    for change, _ in OTHER_CONFIGURATIONS.values():
        edit_manifest(tmp_path / "bundle", lambda manifest, change=change: change(manifest["config"]))
    assert (
        run_app(["parity", str(tmp_path / "bundle"), "--random-weights", "--no-retrace", "--random-inputs", "0"]) == 1
    )
    printed = " ".join(capfd.readouterr().out.split())
    for _, line in OTHER_CONFIGURATIONS.values():
        assert f"differs manifest.json: field config.{line}" in printed


def test_a_bundle_of_an_unknown_preset_needs_its_configuration(tiny_bundle, tmp_path, capfd):
    copy_tree(tiny_bundle, tmp_path / "bundle")
    edit_manifest(tmp_path / "bundle", lambda manifest: manifest.update(preset="my-rig"))
    assert run_app(["parity", str(tmp_path / "bundle"), "--random-weights"]) == 2
    assert "--config FILE" in capfd.readouterr().err
    assert run_app(["parity", str(tmp_path / "bundle"), "--random-weights", "--preset", "tiny", "--no-retrace"]) == 1
    assert "field preset: expected 'tiny'; got 'my-rig'" in " ".join(capfd.readouterr().out.split())


# --- Bisection ----------------------------------------------------------------------------------------------------


@pytest.fixture
def broken_bundle(tiny_bundle, tiny_model, tmp_path):
    """A bundle with a NaN in a weight of the segmenter."""
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.edit_graph("segmenter", nan_in_a_weight)
        yield str(bench.bundle)


def test_bisect_names_the_first_wrong_tensor_and_its_module(broken_bundle, capfd):
    assert run_app(["parity", broken_bundle, *BISECT_ONE_FRAME]) == 1
    printed = " ".join(capfd.readouterr().out.split())
    assert "segmenter.onnx, frame 0: the first tensor with a wrong value is lane_boundary" in printed
    assert "module segmentation.heads.lane_boundary.3" in printed
    assert "constant model.segmentation.heads.lane_boundary.3.bias: 1 of 1 numbers are not finite" in printed


def test_the_json_report_contains_the_bisection(broken_bundle, capfd):
    assert run_app(["parity", broken_bundle, *BISECT_ONE_FRAME, "--json"]) == 1
    report = json.loads(capfd.readouterr().out)
    assert not report["passed"]
    assert report["bisection"]["kind"] == "tensor"
    assert report["bisection"]["operators"] == ["Conv"]


def test_bisect_finds_nothing_where_parity_holds(tiny_bundle, capfd):
    assert run_app(["parity", str(tiny_bundle), *BISECT_ONE_FRAME]) == 0
    assert "no output differs, there is nothing to find" in " ".join(capfd.readouterr().out.split())


def test_without_bisect_there_is_no_bisection(broken_bundle, capfd):
    assert run_app(["parity", broken_bundle, *BISECT_ONE_FRAME[:-1], "--json"]) == 1
    assert "bisection" not in json.loads(capfd.readouterr().out)


# --- A new export --------------------------------------------------------------------------------------------------


@pytest.fixture
def new_export(tiny_bundle, monkeypatch):
    """A new export of the model gives the graphs of `tiny_bundle`. This saves the time of tracing."""
    monkeypatch.setattr(retraced_graphs, "trace", lambda graph, path, dcn: shutil.copy(tiny_bundle / path.name, path))


def test_the_command_compares_the_graphs_with_a_new_export(copied_bundle, new_export, capfd):
    edit_manifest(copied_bundle, lambda manifest: manifest["weights"].update(trained=False))
    command = ["parity", str(copied_bundle), "--random-weights", "--random-inputs", "0"]
    assert run_app(command) == 0
    compared = "new export operators and constants of projector, backbone, lifter, decoder, segmenter compared"
    assert compared in " ".join(capfd.readouterr().out.split())
    edit_graph(copied_bundle, "decoder", lambda model: splice(model, "boxes", "Identity"))
    assert run_app(command) == 1
    printed = " ".join(capfd.readouterr().out.split())
    assert "differs new export, decoder: operator: expected Concat(" in printed
    assert run_app([*command, "--bisect"]) == 1
    assert "a new export of the model has other operators" in " ".join(capfd.readouterr().out.split())
    assert run_app([*command, "--no-retrace"]) == 0
    assert "new export not compared" in " ".join(capfd.readouterr().out.split())


def test_the_bundle_of_another_version_is_not_compared_with_a_new_export(copied_bundle, capfd):
    edit_manifest(copied_bundle, lambda manifest: manifest["weights"].update(trained=False))
    edit_manifest(copied_bundle, lambda manifest: manifest["versions"].update(torch="2.1.0"))
    assert run_app(["parity", str(copied_bundle), "--random-weights", "--random-inputs", "0"]) == 0
    printed = " ".join(capfd.readouterr().out.split())
    assert "new export not compared: the bundle was exported with torch 2.1.0 (installed: " in printed
