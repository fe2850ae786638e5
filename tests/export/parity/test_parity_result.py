"""Parity failures as lines of text."""

from dataclasses import replace

import pytest

from duospacenet.export.parity.frame_error import FrameError
from duospacenet.export.parity.parity_result import ParityResult
from duospacenet.export.parity.tensor_error import TensorError

GOOD_FRAME = FrameError(window=3, boxes=4, unmatched=0, box=0.0, score=0.0, map=0.0, history=0)


def result(graphs=None, stream=(), dead_inputs=()) -> ParityResult:
    return ParityResult("three frames", 3, graphs or {}, list(stream), list(dead_inputs))


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


def test_an_input_that_no_output_depends_on_is_a_failure():
    failing = result(dead_inputs=["decoder.time_delta_s"])
    assert failing.failures == ["decoder.time_delta_s: no output depends on this input"]
    assert not failing.passed
