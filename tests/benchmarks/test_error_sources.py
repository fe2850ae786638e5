"""Corrections of detections by the ground truth, on frames that are small enough to correct by hand."""

import numpy as np
import pytest

from benchmarks.error_sources import (
    CORRECTIONS,
    DetectedFrame,
    flipped_share,
    match,
    score,
    with_true_classes,
    within,
    without_duplicates,
    without_false_positives,
)
from duospacenet.runtime.detections import Detections, HistoryReport
from duospacenet.runtime.frame import GroundTruth

CAR, BUS = "car", "bus"


def boxes(*positions, yaw=0.0):
    """Boxes at positions (x, y), 2 × 4 × 1.5 m, of 1 m/s."""
    return np.array([[x, y, 1, 2, 4, 1.5, yaw, 1, 0] for x, y in positions]).reshape(-1, 9)


def frame(detected, true):
    """detected: (class, x, y, score), in descending order of score. true: (class, x, y)."""
    return DetectedFrame(
        Detections(
            boxes(*[(x, y) for _, x, y, _ in detected]).astype(np.float32),
            np.array([score for *_, score in detected], np.float32),
            tuple(name for name, *_ in detected),
            np.arange(len(detected)),
            HistoryReport(1),
        ),
        GroundTruth(boxes(*[(x, y) for _, x, y in true]), tuple(name for name, *_ in true)),
    )


TWO_CARS = frame(
    [(CAR, 10.0, 0, 0.9), (CAR, 11.5, 0, 0.8), (BUS, 10.5, 0, 0.7), (CAR, 30, 0, 0.6)], [(CAR, 10.4, 0), (CAR, 16, 0)]
)


def scores_of(corrected):
    return corrected.detections.scores.round(1).tolist()


def test_the_best_detection_takes_the_object():
    assert match(TWO_CARS, 2.0) == [(0, 0)]
    assert match(TWO_CARS, 5.0) == [(0, 0), (1, 1)]
    assert match(TWO_CARS, 5.0, same_class=False) == [(0, 0), (1, 1)]


def test_a_duplicate_is_removed_and_a_false_positive_stays():
    assert scores_of(without_duplicates(TWO_CARS)) == pytest.approx([0.9, 0.7, 0.6])


def test_a_false_positive_is_removed_and_a_duplicate_stays():
    assert scores_of(without_false_positives(TWO_CARS)) == pytest.approx([0.9, 0.8])


def test_positions_are_corrected_within_four_metres_and_once_per_object():
    corrected = CORRECTIONS["positions (of detections within 4 m)"](TWO_CARS)
    assert corrected.detections.boxes[:, 0].tolist() == pytest.approx([10.4, 11.5, 10.5, 30])


@pytest.mark.parametrize(("name", "column", "value"), [("headings", 6, 0.5), ("velocities", 7, -3.0)])
def test_a_correction_changes_its_columns_only(name, column, value):
    single = frame([(CAR, 10, 0, 0.9)], [(CAR, 10.5, 0)])
    single.ground_truth.boxes[0, column] = value
    before, after = single.detections.boxes[0], CORRECTIONS[name](single).detections.boxes[0]
    assert after[column] == pytest.approx(value)
    assert (np.delete(before, column) == np.delete(after, column)).all()


def test_the_class_of_the_nearest_object_replaces_a_wrong_one():
    corrected = with_true_classes(frame([(BUS, 10, 0, 0.9)], [(CAR, 10.5, 0), (BUS, 13, 0)]))
    assert corrected.detections.classes == (CAR,)


def test_a_range_keeps_its_detections_and_objects():
    kept = within(TWO_CARS, 11, 31)
    assert scores_of(kept) == pytest.approx([0.8, 0.6])
    assert kept.ground_truth.boxes[:, 0].tolist() == [16]
    assert kept.detections.attributes == ("vehicle.moving", "vehicle.moving")


def test_the_opposite_heading_is_counted_as_flipped_for_confident_detections():
    pair = [frame([(CAR, 10, 0, 0.9)], [(CAR, 10, 0)]), frame([(CAR, 10, 0, 0.9)], [(CAR, 10, 0)])]
    pair[1].detections.boxes[0, 6] = np.pi - 0.1
    assert flipped_share(pair, CAR) == 0.5
    pair[1].detections.scores[0] = 0.2
    assert flipped_share(pair, CAR) == 0.0
    assert np.isnan(flipped_share(pair, BUS))


@pytest.mark.parametrize("name", CORRECTIONS)
def test_frames_without_detections_or_objects_can_be_corrected_and_scored(name):
    empty = [frame([], []), frame([], [(CAR, 10, 0)]), frame([(CAR, 10, 0, 0.5)], [])]
    assert score(map(CORRECTIONS[name], empty)).num_samples == 3
