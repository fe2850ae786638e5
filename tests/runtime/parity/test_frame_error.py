"""Errors of streamed frames equal values computed by hand."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.runtime import Detections
from duospacenet.runtime.detections import HistoryReport, select_detections
from duospacenet.runtime.parity.frame_error import FrameError

CLASSES = ("car", "bus")
LOGITS = np.array([[2.0, -3.0], [0.5, 1.0]], np.float32)
BOXES = np.array([[1, 2, 3, 2, 4, 1.5, 3.1, 1, 0], [5, 6, 0, 1, 1, 1, -1, 0, 0]], np.float32)
MAP = np.zeros((1, 1, 2, 2), np.float32)


def test_equal_boxes_have_no_error():
    assert compare(detect()) == FrameError(window=3, boxes=4, unmatched=0, box=0, score=0, map=0, history=0)


def test_the_box_error_is_the_largest_difference_and_yaw_wraps_around():
    boxes = BOXES.copy()
    boxes[0, 6] = 3.1 - 2 * np.pi + 0.01
    assert compare(detect(boxes=boxes)).box == pytest.approx(0.01, abs=1e-6)
    boxes[1, 4] += 0.25
    assert compare(detect(boxes=boxes)).box == pytest.approx(0.25)


def test_the_yaw_error_of_a_query_counts_by_the_length_of_its_heading_vector():
    boxes = BOXES.copy()
    boxes[1, 6] += 0.01
    reference = {"class_logits": LOGITS, "boxes": BOXES, "drivable_area": MAP}
    for lengths, expected in (((0.1, 1.0), 0.01), ((1.0, 0.1), 0.001)):
        error = FrameError.between(detect(boxes=boxes), reference, CLASSES, 3, 1e-3, np.array(lengths))
        assert error.box == pytest.approx(expected, abs=1e-6)


def test_scores_are_compared_as_probabilities():
    logits = LOGITS.copy()
    logits[1, 0] = 0.0
    assert compare(detect(logits=logits)).score == pytest.approx(1 / (1 + np.exp(-0.5)) - 0.5, abs=1e-6)


def test_a_box_that_only_one_side_selected_is_unmatched():
    all_boxes = detect()
    without_best = Detections(
        all_boxes.boxes[1:],
        all_boxes.scores[1:],
        all_boxes.classes[1:],
        all_boxes.queries[1:],
        HistoryReport(3),
        all_boxes.maps,
    )
    assert compare(without_best).unmatched == 1


def test_a_missing_box_counts_unless_its_score_is_near_the_lowest_one():
    """The scores are 0.881, 0.378, 0.050 and 0.047. The last two differ by more than the tolerance of 0.001."""
    logits = np.array([[2.0, -0.5], [-3.0, -2.944]], np.float32)
    reference = {"class_logits": logits, "boxes": BOXES, "drivable_area": MAP}
    for missing, unmatched in ((0, 1), (1, 1), (2, 1), (3, 0)):
        found = detect(logits)
        kept = [index for index in range(4) if index != missing]
        classes = tuple(found.classes[index] for index in kept)
        detections = replace(
            found, boxes=found.boxes[kept], scores=found.scores[kept], classes=classes, queries=found.queries[kept]
        )
        error = FrameError.between(detections, reference, CLASSES, num_frames=3, score_tolerance=1e-3)
        assert error.unmatched == unmatched


def test_a_window_of_another_length_is_a_history_error():
    assert compare(detect(frames=2)).history == -1


def test_maps_are_compared_as_probabilities():
    masks = {"drivable_area": np.full((2, 2), 0.75, np.float32)}
    assert compare(detect(maps=masks)).map == pytest.approx(0.25)


def detect(logits=LOGITS, boxes=BOXES, frames=3, maps=None) -> Detections:
    queries, labels, scores, _ = select_detections(logits, boxes)
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
