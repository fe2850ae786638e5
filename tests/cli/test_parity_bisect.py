"""`duospacenet parity --bisect`, from end to end."""

import json

import pytest

from duospacenet.cli.main import run_app
from tests.faults.bench import Bench
from tests.faults.bundle_faults import nan_in_a_weight

ONE_FRAME = ["--random-weights", "--source", "synthetic:3:1", "--bisect"]


@pytest.fixture
def broken_bundle(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.edit_graph("segmenter", nan_in_a_weight)
        yield str(bench.bundle)


def test_bisect_says_where_to_look(broken_bundle, capfd):
    assert run_app(["parity", broken_bundle, *ONE_FRAME]) == 1
    printed = " ".join(capfd.readouterr().out.split())
    assert "segmenter.onnx, frame 0: the first tensor that is computed wrongly is lane_boundary" in printed
    assert "module segmentation.heads.lane_boundary.3" in printed
    assert "constant model.segmentation.heads.lane_boundary.3.bias: 1 of 1 numbers are not finite" in printed


def test_bisect_stands_in_the_json_report(broken_bundle, capfd):
    assert run_app(["parity", broken_bundle, *ONE_FRAME, "--json"]) == 1
    report = json.loads(capfd.readouterr().out)
    assert not report["passed"]
    assert report["bisection"]["kind"] == "tensor"
    assert report["bisection"]["operators"] == ["Conv"]


def test_bisect_has_nothing_to_find_where_parity_holds(tiny_bundle, capfd):
    assert run_app(["parity", str(tiny_bundle), *ONE_FRAME]) == 0
    assert "nothing to find, parity holds" in capfd.readouterr().out


def test_without_bisect_nothing_is_looked_for(broken_bundle, capfd):
    assert run_app(["parity", broken_bundle, *ONE_FRAME[:-1], "--json"]) == 1
    assert "bisection" not in json.loads(capfd.readouterr().out)
