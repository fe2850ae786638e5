"""`duospacenet parity` from end to end, with `--bisect` too."""

import json
import re

import pytest

from duospacenet.cli.main import run_app
from tests.faults.bench import Bench
from tests.faults.bundle_faults import nan_in_a_weight
from tests.helpers.bundles import edit_manifest
from tests.helpers.scene_files import copy_tree

BISECT_ONE_FRAME = ["--random-weights", "--source", "synthetic:3:1", "--bisect"]


def test_parity_with_other_weights_ends_with_1(tiny_bundle, capfd):
    source = ["--source", "synthetic:3:2", "--json"]
    assert run_app(["parity", str(tiny_bundle), "--random-weights", "--seed", "0", *source]) == 0
    assert json.loads(capfd.readouterr().out)["passed"] is True
    assert run_app(["parity", str(tiny_bundle), "--random-weights", "--seed", "1", *source]) == 1
    printed = capfd.readouterr()
    assert json.loads(printed.out)["passed"] is False
    assert "the bundle was made from other weights" in printed.err


INVALID_CONFIGURATIONS = {
    "another kind of block": (lambda config: config["backbone"].update(block="wide"), "field config"),
    "no heads": (lambda config: config.update(num_heads=0), "field config"),
    "a word for a number": (lambda config: config.update(channels="many"), "field config"),
    "fewer queries": (lambda config: config.update(num_queries=16), "mis-shaped|got different inputs or outputs"),
    "more layers": (lambda config: config.update(num_layers=3), "got different inputs or outputs"),
}


@pytest.mark.parametrize("case", INVALID_CONFIGURATIONS)
def test_a_configuration_that_does_not_fit_the_bundle_is_refused(tiny_bundle, tmp_path, capfd, case):
    change, words = INVALID_CONFIGURATIONS[case]
    copy_tree(tiny_bundle, tmp_path / "bundle")
    edit_manifest(tmp_path / "bundle", lambda manifest: change(manifest["config"]))
    assert run_app(["parity", str(tmp_path / "bundle"), "--random-weights"]) == 4
    assert re.search(words, capfd.readouterr().err)


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
    assert "parity holds, there is nothing to find" in " ".join(capfd.readouterr().out.split())


def test_without_bisect_there_is_no_bisection(broken_bundle, capfd):
    assert run_app(["parity", broken_bundle, *BISECT_ONE_FRAME[:-1], "--json"]) == 1
    assert "bisection" not in json.loads(capfd.readouterr().out)
