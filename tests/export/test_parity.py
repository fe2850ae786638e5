"""The proof itself: that it passes on what is equal, and that it finds what is not."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx
import pytest
from bundles import edit_graph
from driving import TINY_SIZE_PX
from onnx import numpy_helper

from duospacenet.export import check_parity, export_bundle
from duospacenet.export.drive import scripted_drive
from duospacenet.model import PRESETS, DuoSpaceNet, randomise
from duospacenet.runtime import history, pipeline

THREE_FRAMES = scripted_drive(*TINY_SIZE_PX)[:3]


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
    assert json.loads((tiny_bundle / "manifest.json").read_text())["parity"] == full_report.to_proof().model_dump(
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


def test_an_input_folded_to_the_traced_example_is_found(copy_of_bundle, tiny_model):
    def fold_time(model: onnx.ModelProto) -> None:
        """What a tracer does to a value that passes through numpy: its consumers see a constant."""
        model.graph.initializer.append(
            numpy_helper.from_array(np.array([0, 0.5, 1.0, 1.5], np.float32), "traced_example")
        )
        for node in model.graph.node:
            node.input[:] = ["traced_example" if name == "time_delta_s" else name for name in node.input]

    bundle = copy_of_bundle(decoder=fold_time)
    report = check_parity(bundle, tiny_model, THREE_FRAMES)
    assert report.dead_inputs == ["decoder.time_delta_s"]
    assert not report.passed


def test_nan_weights_in_a_graph_are_found(copy_of_bundle, tiny_model):
    def poison(model: onnx.ModelProto) -> None:
        bias = next(tensor for tensor in model.graph.initializer if tensor.name.endswith("lane_boundary.3.bias"))
        bias.CopyFrom(numpy_helper.from_array(np.full([1], np.nan, np.float32), bias.name))

    report = check_parity(copy_of_bundle(segmenter=poison), tiny_model, THREE_FRAMES[:1])
    assert report.failures[0].startswith("segmenter.lane_boundary, frame 0: relative error inf")
    json.dumps(report.to_proof().model_dump(mode="json"), allow_nan=False)


def swap_red_and_blue(frame):
    return replace(frame, images={name: image[..., ::-1].copy() for name, image in frame.images.items()})


def mirror_cameras(frame):
    calibrations = dict(zip(frame.cameras, reversed(frame.cameras.values()), strict=True))
    return replace(frame, cameras=calibrations)


@pytest.mark.parametrize("fault", [swap_red_and_blue, mirror_cameras])
def test_a_wrong_feed_of_the_stream_is_found(tiny_bundle, tiny_model, monkeypatch, fault):
    step = pipeline.Stream.step
    monkeypatch.setattr(pipeline.Stream, "step", lambda stream, frame: step(stream, fault(frame)))
    report = check_parity(tiny_bundle, tiny_model, THREE_FRAMES[:1])
    assert all(line.startswith("stream") for line in report.failures)
    assert not report.passed


def test_a_stale_slot_is_found(tiny_bundle, tiny_model, monkeypatch):
    after = history.History.after
    monkeypatch.setattr(history.History, "after", lambda self, now: self if self._past else after(self, now))
    report = check_parity(tiny_bundle, tiny_model, THREE_FRAMES)
    assert report.failures
    assert all(line.startswith("stream, frame 2") for line in report.failures)


def test_a_report_of_one_frame_still_proves_every_input_alive(tiny_bundle, tiny_model):
    report = check_parity(tiny_bundle, tiny_model, THREE_FRAMES[:1], source="one frame")
    assert report.passed, report.failures
    assert report.to_proof().source == "one frame"


@pytest.fixture
def copy_of_bundle(tiny_bundle, tmp_path) -> Callable[..., Path]:
    """Copies the tiny bundle and changes graphs in it, the hashes with them."""

    def copy(**changes: Callable[[onnx.ModelProto], None]) -> Path:
        bundle = Path(shutil.copytree(tiny_bundle, tmp_path / "bundle"))
        for name, change in changes.items():
            edit_graph(bundle, name, change)
        return bundle

    return copy
