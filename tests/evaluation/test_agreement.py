"""The agreement of two detectors on hand-made frames."""

import numpy as np
import pytest

from duospacenet.evaluation.agreement import Agreement
from duospacenet.runtime.detections import Detections, HistoryReport


def detections(*rows: tuple[str, float, float, float]) -> Detections:
    """Boxes of a class at (x, y) with a score, highest score first."""
    boxes = np.zeros((len(rows), 9), np.float32)
    boxes[:, :2] = [row[1:3] for row in rows] if rows else np.zeros((0, 2))
    return Detections(
        boxes=boxes,
        scores=np.array([row[3] for row in rows], np.float32),
        classes=tuple(row[0] for row in rows),
        queries=np.arange(len(rows)),
        history=HistoryReport(1),
    )


def agreement(reference: Detections, other: Detections) -> Agreement:
    result = Agreement()
    result.add(reference, other)
    return result


def test_the_same_detections_agree_completely():
    frame = detections(("car", 0, 0, 0.9), ("bus", 5, 5, 0.4))
    result = agreement(frame, frame)
    assert (result.boxes, result.matched_fraction) == (2, 1.0)
    assert (result.mean_score_difference, result.mean_distance_m) == (0.0, 0.0)


def test_differences_are_means_over_the_matched_boxes():
    reference = detections(("car", 0, 0, 0.9), ("car", 10, 0, 0.5), ("bus", 20, 0, 0.3))
    other = detections(("car", 0.3, 0.4, 0.8), ("car", 10.1, 0, 0.7), ("bus", 22, 0, 0.3))
    result = agreement(reference, other)
    assert (result.boxes, result.matched) == (3, 2)
    assert result.mean_score_difference == pytest.approx((0.1 + 0.2) / 2, abs=1e-6)
    assert result.mean_distance_m == pytest.approx((0.5 + 0.1) / 2, abs=1e-6)


def test_a_detection_is_matched_once_with_the_best_of_the_reference():
    result = agreement(detections(("car", 0, 0, 0.9), ("car", 0.2, 0, 0.8)), detections(("car", 0.2, 0, 0.7)))
    assert (result.boxes, result.matched) == (2, 1)
    assert result.mean_distance_m == pytest.approx(0.2, abs=1e-6)


def test_another_class_does_not_match():
    assert agreement(detections(("car", 0, 0, 0.9)), detections(("truck", 0, 0, 0.9))).matched == 0


def test_boxes_of_low_score_are_not_compared():
    result = agreement(detections(("car", 0, 0, 0.9), ("car", 9, 0, 0.09)), detections(("car", 0, 0, 0.05)))
    assert (result.boxes, result.matched) == (1, 1)


@pytest.mark.parametrize("other", [detections(), detections(("car", 0, 0, 0.9))])
def test_without_boxes_of_the_reference_nothing_disagrees(other):
    assert agreement(detections(), other).matched_fraction == 1.0


def test_without_detections_nothing_is_matched():
    assert agreement(detections(("car", 0, 0, 0.9)), detections()).matched_fraction == 0.0


def test_frames_are_added_up():
    result = agreement(detections(("car", 0, 0, 0.9)), detections(("car", 0, 0, 0.9)))
    result.add(detections(("car", 0, 0, 0.9)), detections())
    assert (result.boxes, result.matched, result.matched_fraction) == (2, 1, 0.5)
