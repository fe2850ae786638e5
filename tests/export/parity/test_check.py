"""The parity check passes for an equal bundle and fails for a different one."""

import json

import pytest

from duospacenet.export import check_parity, export_bundle
from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from tests.faults.bench import Bench
from tests.faults.bundle_faults import nan_in_a_weight
from tests.helpers.streams import TINY_SIZE_PX

THREE_FRAMES = stress_sequence(*TINY_SIZE_PX)[:3]


@pytest.fixture(scope="module")
def full_result(tiny_bundle, tiny_model):
    return check_parity(tiny_bundle, tiny_model)


def test_tiny_equals_eager_mode_on_the_stress_sequence(full_result):
    assert full_result.passed, full_result.failures
    assert full_result.frames >= 12
    assert full_result.source == "stress sequence"
    assert full_result.dead_inputs == []
    assert max(error.relative for graph in full_result.graphs.values() for error in graph.values()) <= 1e-4
    assert max(error.box for error in full_result.stream) <= 1e-3
    assert max(error.score for error in full_result.stream) <= 1e-3


def test_every_output_of_every_graph_is_compared(full_result, tiny_bundle):
    manifest = json.loads((tiny_bundle / "manifest.json").read_text())
    for name, graph in manifest["graphs"].items():
        assert set(full_result.graphs[name]) == {tensor["name"] for tensor in graph["outputs"]}


def test_the_manifest_holds_the_parity_report_of_the_export(full_result, tiny_bundle):
    assert json.loads((tiny_bundle / "manifest.json").read_text())["parity"] == full_result.to_report().model_dump(
        mode="json"
    )


@pytest.mark.slow
def test_nano_equals_eager_mode(tmp_path):
    result = export_bundle(randomise(DuoSpaceNet(PRESETS["nano"])), tmp_path / "nano")
    assert result.passed, result.failures


def test_a_model_with_other_weights_fails_in_the_graphs_and_in_the_stream(tiny_bundle):
    result = check_parity(tiny_bundle, randomise(DuoSpaceNet(PRESETS["tiny"]), seed=1), THREE_FRAMES)
    assert any(line.startswith("backbone.pv_0, frame ") for line in result.failures)
    assert any(line.startswith("stream, frame 0") for line in result.failures)


def test_a_nan_in_a_graphs_weights_fails_and_its_report_is_strict_json(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.edit_graph("segmenter", nan_in_a_weight)
        result = check_parity(bench.bundle, tiny_model, THREE_FRAMES[:1])
    assert result.failures[0] == ("segmenter.lane_boundary, frame 0: relative error inf exceeds the tolerance 0.0001")
    json.dumps(result.to_report().model_dump(mode="json"), allow_nan=False)


def test_one_frame_is_enough_to_check_that_every_input_is_used(tiny_bundle, tiny_model):
    result = check_parity(tiny_bundle, tiny_model, THREE_FRAMES[:1], source="one frame")
    assert result.passed, result.failures
    assert result.to_report().source == "one frame"
