"""The measures of parity, against numbers worked by hand."""

import numpy as np
import pytest

from duospacenet.export.parity.comparison import FrameError, TensorError
from duospacenet.runtime import Detections
from duospacenet.runtime.detections import HistoryReport, select

CLASSES = ("car", "bus")
LOGITS = np.array([[2.0, -3.0], [0.5, 1.0]], np.float32)
BOXES = np.array([[1, 2, 3, 2, 4, 1.5, 3.1, 1, 0], [5, 6, 0, 1, 1, 1, -1, 0, 0]], np.float32)
MAP = np.zeros((1, 1, 2, 2), np.float32)


def test_the_error_of_a_tensor_is_measured_against_the_rms_of_the_reference():
    error = TensorError.between(np.array([3.0, 4.5]), np.array([3.0, 4.0]))
    assert error.absolute == 0.5
    assert error.relative == pytest.approx(0.5 / np.sqrt(12.5))
    assert error.cosine == pytest.approx((9 + 18) / (5 * np.hypot(3, 4.5)))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_infinitely_wrong_on_either_side_and_even_on_both(value):
    good, bad = np.ones(2), np.array([1.0, value])
    for actual, expected in ((bad, good), (good, bad), (bad, bad)):
        assert TensorError.between(actual, expected).relative == np.inf


def test_a_reference_of_zeros_allows_nothing_but_zeros():
    assert TensorError.between(np.zeros(3), np.zeros(3)).relative == 0
    assert TensorError.between(np.full(3, 1e-9), np.zeros(3)).relative == np.inf


def test_another_shape_is_infinitely_wrong():
    assert TensorError.between(np.ones((2, 1)), np.ones((1, 2))).relative == np.inf


def test_equal_boxes_have_no_error():
    assert compare(detect()) == FrameError(window=3, boxes=4, unmatched=0, box=0, score=0, map=0, history=0)


def test_the_largest_difference_of_a_box_counts_and_yaw_goes_round():
    boxes = BOXES.copy()
    boxes[0, 6] = 3.1 - 2 * np.pi + 0.01
    assert compare(detect(boxes=boxes)).box == pytest.approx(0.01, abs=1e-6)
    boxes[1, 4] += 0.25
    assert compare(detect(boxes=boxes)).box == pytest.approx(0.25)


def test_scores_are_compared_as_probabilities():
    logits = LOGITS.copy()
    logits[1, 0] = 0.0
    assert compare(detect(logits=logits)).score == pytest.approx(1 / (1 + np.exp(-0.5)) - 0.5, abs=1e-6)


def test_a_box_that_only_one_side_found_is_unmatched():
    found = detect()
    kept = slice(1, None)
    less = Detections(
        found.boxes[kept], found.scores[kept], found.classes[1:], found.queries[kept], HistoryReport(3), found.maps
    )
    assert compare(less).unmatched == 1


def test_a_window_of_another_length_is_told():
    assert compare(detect(frames=2)).history == -1


def test_maps_are_compared_as_probabilities():
    masks = {"drivable_area": np.full((2, 2), 0.75, np.float32)}
    assert compare(detect(maps=masks)).map == pytest.approx(0.25)


def detect(logits=LOGITS, boxes=BOXES, frames=3, maps=None) -> Detections:
    queries, labels, scores, _ = select(logits, boxes)
    return Detections(
        boxes=boxes[queries],
        scores=scores,
        classes=tuple(CLASSES[label] for label in labels),
        queries=queries,
        history=HistoryReport(frames),
        maps={"drivable_area": np.full((2, 2), 0.5, np.float32)} if maps is None else maps,
    )


def compare(detections: Detections) -> FrameError:
    reference = {"class_logits": LOGITS, "boxes": BOXES, "drivable_area": MAP}
    return FrameError.between(detections, reference, CLASSES, num_frames=3, score_tolerance=1e-3)


def test_boxes_are_compared_number_by_number_and_yaw_goes_round():
    """A yaw off by 0.01 rad is 0.1 of a yaw RMS of 0.1, however many metres stand beside it."""
    expected = np.tile(np.array([[40.0, 30, 1, 2, 4, 1.5, 0.1, 5, 1]]), (4, 1))
    off = expected.copy()
    off[2, 6] += 0.01
    assert TensorError.between_boxes(off, expected).relative == pytest.approx(0.1)
    turned = expected.copy()
    turned[:, 6] += 2 * np.pi
    assert TensorError.between_boxes(turned, expected).relative == pytest.approx(0, abs=1e-12)


def test_the_worst_frame_is_named():
    errors = [TensorError(1.0, 0.5, 1.0, frame=3), TensorError(0.5, 0.9, 1.0, frame=7)]
    assert TensorError.worst(errors).frame == 7
