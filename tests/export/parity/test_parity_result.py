"""Parity failures as lines of text."""

from dataclasses import replace

import pytest

from duospacenet.export.parity.liveness import Liveness
from duospacenet.export.parity.manifest_differences import FieldDifference
from duospacenet.runtime.parity.frame_error import FrameError
from duospacenet.runtime.parity.tensor_error import TensorError
from tests.helpers.parity_results import NO_WEIGHTS, passing_result

GOOD_FRAME = FrameError(window=3, boxes=4, unmatched=0, box=0.0, score=0.0, map=0.0, history=0)


def result(graphs=None, stream=(), **changes):
    return passing_result(graphs=graphs or {}, stream=list(stream), **changes)


def test_a_result_without_violations_passes():
    good = result({"decoder": {"boxes": TensorError(1e-5, 1e-5, 1.0)}}, [GOOD_FRAME])
    assert good.passed
    assert good.failures == []
    assert good.failing_frames == []


def test_a_graph_failure_names_the_output_the_frame_and_both_numbers():
    failing = result({"decoder": {"boxes": TensorError(0.5, 0.0123, 1.0, frame=7)}})
    assert failing.failures == ["decoder.boxes, frame 7: relative error 0.012 exceeds the tolerance 0.0001"]


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"box": 0.25}, "box error 0.25 exceeds the tolerance 0.001"),
        ({"score": 0.002}, "score error 0.002 exceeds the tolerance 0.001"),
        ({"map": float("nan")}, "map error nan exceeds the tolerance 0.001"),
        ({"unmatched": 2}, "2 boxes were selected by one side only"),
        ({"history": -2}, "the window has 1 frames, expected 3"),
    ],
)
def test_a_stream_failure_names_the_frame_and_the_quantity(change, line):
    failing = result(stream=[GOOD_FRAME, replace(GOOD_FRAME, **change)])
    assert failing.failures == [f"stream, frame 1: {line}"]
    assert failing.failing_frames == [1]


def test_a_graph_failure_on_random_inputs_names_the_seed():
    failing = result({"decoder": {"boxes": TensorError(0.5, 0.0123, 1.0, frame=None, seed=7)}})
    assert failing.failures == ["decoder.boxes, random input 7: relative error 0.012 exceeds the tolerance 0.0003"]


OTHER_FAILURES = {
    "an element of an input": (
        {"liveness": {"decoder": Liveness(554, ["decoder.camera_valid[slot 3, camera 1]"])}},
        "decoder.camera_valid[slot 3, camera 1]: disturbed by itself, it changes the outputs differently",
    ),
    "a field of the manifest": (
        {"manifest": [FieldDifference("window.largest_speed_m_s", "70.0", "0.01")]},
        "manifest.json: field window.largest_speed_m_s: expected 70.0; got 0.01",
    ),
    "a constant": (
        {"weights": replace(NO_WEIGHTS, unexplained=("decoder.val_3",))},
        "decoder.val_3: expected a tensor of the model; got other numbers",
    ),
    "coverage": (
        {"shortfalls": ["coverage: 5 of 6 cameras are lost in slot 2"]},
        "coverage: 5 of 6 cameras are lost in slot 2",
    ),
}


@pytest.mark.parametrize("case", OTHER_FAILURES)
def test_every_other_kind_of_failure_fails_by_itself_and_has_a_line(case):
    changes, line = OTHER_FAILURES[case]
    failing = result(**changes)
    assert failing.failures == [line]
    assert not failing.passed
    assert failing.to_report().failures == (line,)
