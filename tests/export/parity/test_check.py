"""The parity check passes for an equal bundle and fails for a different one."""

import json

import pytest

from duospacenet.export import check_parity, export_bundle
from duospacenet.export.parity.stress_sequence import stress_sequence
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from tests.faults.bench import Bench
from tests.faults.bundle_faults import nan_in_a_weight, time_made_constant
from tests.helpers.bundles import edit_manifest
from tests.helpers.streams import lose_cameras

THREE_FRAMES = stress_sequence(PRESETS["tiny"])[:3]


@pytest.fixture(scope="module")
def full_result(tiny_bundle, tiny_model):
    return check_parity(tiny_bundle, tiny_model)


def test_tiny_equals_eager_mode_on_the_stress_sequence(full_result):
    assert full_result.passed, full_result.failures
    assert full_result.frames == 14
    assert full_result.source == "stress sequence"
    assert full_result.wrong_elements == []
    assert full_result.random_inputs == {"projector": 12, "backbone": 2, "lifter": 4, "decoder": 12, "segmenter": 12}
    assert full_result.weights.matched == full_result.weights.parameters > 200
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
    result = check_parity(
        tiny_bundle, randomise(DuoSpaceNet(PRESETS["tiny"]), seed=1), stress_frames=THREE_FRAMES, random_inputs=1
    )
    assert any(line.startswith("backbone.reduced_pv_0, ") for line in result.failures)
    assert any(line.startswith("stream, frame 0") for line in result.failures)
    assert any(line.startswith("manifest.json: field weights.sha256") for line in result.failures)
    assert len(result.weights.differing) > 50


def test_a_nan_in_a_graphs_weights_fails_and_its_report_is_strict_json(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.edit_graph("segmenter", nan_in_a_weight)
        result = check_parity(bench.bundle, tiny_model, stress_frames=THREE_FRAMES[:1], random_inputs=0)
    assert result.failures[0] == ("segmenter.lane_boundary, frame 0: not all numbers are finite")
    json.dumps(result.to_report().model_dump(mode="json"), allow_nan=False)


def test_frames_of_the_user_are_compared_after_the_stress_sequence(tiny_bundle, tiny_model, frames):
    """The second frame has no image, so it is skipped. The stress sequence is still there, with its coverage."""
    own = [frames[0], lose_cameras(frames[1], *frames[1].images), frames[2]]
    result = check_parity(tiny_bundle, tiny_model, own, "my rig", random_inputs=1)
    assert result.passed, result.failures
    assert (result.source, result.frames) == ("stress sequence and my rig", 17)
    assert [error.window for error in result.stream[14:]] == [1, 0, 2]
    assert result.coverage.frames == 14


def test_a_short_stress_sequence_fails_by_its_coverage_alone(tiny_bundle, tiny_model):
    result = check_parity(tiny_bundle, tiny_model, stress_frames=THREE_FRAMES, random_inputs=1)
    assert result.shortfalls and result.failures == result.shortfalls


def test_the_window_limits_come_from_the_model_and_not_from_the_bundle(tiny_bundle, tiny_model, tmp_path):
    """With the limits of this manifest, the pipeline drops the history at every frame."""
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        edit_manifest(bench.bundle, lambda manifest: manifest["window"].update(largest_speed_m_s=0.01))
        result = check_parity(bench.bundle, tiny_model, random_inputs=0)
    assert "manifest.json: field window.largest_speed_m_s: expected 70.0; got 0.01" in result.failures
    assert "stream, frame 4: the window has 1 frames, expected 4" in result.failures


def test_boxes_of_classes_that_the_model_does_not_have_are_unmatched(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        edit_manifest(bench.bundle, lambda manifest: manifest.update(classes=[f"kind_{i}" for i in range(10)]))
        result = check_parity(bench.bundle, tiny_model, stress_frames=THREE_FRAMES[:1], random_inputs=0)
    assert result.stream[0].unmatched >= result.stream[0].boxes > 0


def test_the_worst_random_input_is_named_and_gives_the_same_error_again(tiny_bundle, tiny_model, tmp_path):
    """The decoder reads the age of slot 3 as a constant. Only random inputs with a valid slot 3 show it."""
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.edit_graph("decoder", time_made_constant)
        results = [
            check_parity(bench.bundle, tiny_model, stress_frames=THREE_FRAMES[:1], random_inputs=12) for _ in range(2)
        ]
    (graph, output, error), *_ = results[0].failing_outputs
    assert (graph, output, error.frame) == ("decoder", "class_logits", None)
    assert error.seed in range(12)
    assert results[0].failures == results[1].failures
