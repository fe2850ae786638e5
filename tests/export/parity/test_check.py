"""The proof itself: that it passes on what is equal, and that it finds what is not."""

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
def full_report(tiny_bundle, tiny_model):
    return check_parity(tiny_bundle, tiny_model)


def test_tiny_is_equal_to_eager_mode_on_the_scripted_drive(full_report):
    assert full_report.passed, full_report.failures
    assert full_report.frames >= 12
    assert full_report.dead_inputs == []
    assert max(error.relative for graph in full_report.graphs.values() for error in graph.values()) <= 1e-4
    assert max(error.box for error in full_report.stream) <= 1e-3
    assert max(error.score for error in full_report.stream) <= 1e-3


def test_every_output_of_every_graph_is_compared(full_report, tiny_bundle):
    manifest = json.loads((tiny_bundle / "manifest.json").read_text())
    for name, graph in manifest["graphs"].items():
        assert set(full_report.graphs[name]) == {tensor["name"] for tensor in graph["outputs"]}


def test_the_manifest_holds_what_was_measured_at_export(full_report, tiny_bundle):
    assert json.loads((tiny_bundle / "manifest.json").read_text())["parity"] == full_report.to_report().model_dump(
        mode="json"
    )


@pytest.mark.slow
def test_nano_is_equal_to_eager_mode(tmp_path):
    report = export_bundle(randomise(DuoSpaceNet(PRESETS["nano"])), tmp_path / "nano")
    assert report.passed, report.failures


def test_other_weights_are_found(tiny_bundle):
    report = check_parity(tiny_bundle, randomise(DuoSpaceNet(PRESETS["tiny"]), seed=1), THREE_FRAMES)
    assert any(line.startswith("backbone.pv_0, frame ") for line in report.failures)
    assert any(line.startswith("stream, frame 0") for line in report.failures)


def test_nan_weights_in_a_graph_are_found(tiny_bundle, tiny_model, tmp_path):
    with Bench(tiny_bundle, tiny_model, tmp_path) as bench:
        bench.edit_graph("segmenter", nan_in_a_weight)
        report = check_parity(bench.bundle, tiny_model, THREE_FRAMES[:1])
    assert report.failures[0].startswith("segmenter.lane_boundary, frame 0: relative error inf")
    json.dumps(report.to_report().model_dump(mode="json"), allow_nan=False)


def test_a_report_of_one_frame_still_proves_every_input_alive(tiny_bundle, tiny_model):
    report = check_parity(tiny_bundle, tiny_model, THREE_FRAMES[:1], source="one frame")
    assert report.passed, report.failures
    assert report.to_report().source == "one frame"
