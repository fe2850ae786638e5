"""Tests of validation scores: what they are read from, the score that selects the best weights, and their texts."""

import json

import numpy as np
import pytest

from duospacenet.evaluation import Sample, evaluate
from duospacenet.runtime.detections import Detections, HistoryReport
from duospacenet.runtime.frame import GroundTruth
from duospacenet.training.watching.validation_scores import ValidationScores

BOTH = ValidationScores(4, "drives", 0.25, 0.5, 1.5, {"drivable_area": 0.75, "lane_boundary": 0.5})
MAPS = ValidationScores(4, "drives", None, None, None, {"drivable_area": 0.75, "lane_boundary": None})


def sample_of(boxes, predicted, truth, has_boxes=True):
    """A frame in which every true box of a car is found exactly, and one map class has these masks."""
    boxes = np.array(boxes, float).reshape(-1, 9)
    names, scores = ("car",) * len(boxes), np.ones(len(boxes), np.float32)
    maps = {"drivable_area": np.array(predicted, np.float32)}
    found = Detections(boxes.astype(np.float32), scores, names, np.arange(len(boxes)), HistoryReport(1), maps)
    known = (boxes, names) if has_boxes else (np.zeros((0, 9)), ())
    return Sample(found, GroundTruth(*known, {"drivable_area": np.array(truth, bool)}, has_boxes))


def test_the_scores_are_those_of_the_evaluator():
    """All cars are found without error: AP 1 for one of ten classes. The map has 1 of 2 cells."""
    car = [10, 0, 1, 2, 4, 1.5, 0, 1, 0]
    report = evaluate([sample_of([car], [[1, 0]], [[1, 1]])])
    scores = ValidationScores.of_report(7, "drives", report)
    assert scores.mean_average_precision == pytest.approx(0.1)
    assert scores.nds == pytest.approx(report.nds)
    assert scores.velocity_error == pytest.approx(report.mean_errors["velocity"])
    assert scores.map_iou == {"drivable_area": 0.5}
    assert (scores.step, scores.data) == (7, "drives")


def test_scores_of_maps_alone_have_no_score_of_boxes():
    scores = ValidationScores.of_report(7, "d", evaluate([sample_of([], [[1, 0]], [[1, 1]], has_boxes=False)]))
    assert (scores.mean_average_precision, scores.nds, scores.velocity_error) == (None, None, None)
    assert scores.scores() == {"IoU drivable_area": 0.5}


def test_the_best_weights_are_those_with_the_best_nds_or_the_best_mean_iou_without_boxes():
    assert BOTH.quality == ("NDS", 0.5)
    assert MAPS.quality == ("mean map IoU", 0.375)  # an undefined IoU counts as 0


def test_the_line_of_the_log_contains_all_scores():
    line = BOTH.to_dict()
    assert line["step"] == 4
    assert line["validation"] == {
        "mAP": 0.25,
        "NDS": 0.5,
        "mAVE": 1.5,
        "map_iou": {"drivable_area": 0.75, "lane_boundary": 0.5},
        "data": "drives",
    }
    for scores in (BOTH, MAPS):
        assert ValidationScores.from_dict(json.loads(json.dumps(scores.to_dict()))) == scores


def test_scores_in_one_line():
    assert BOTH.describe() == ("mAP 0.250, NDS 0.500, mAVE 1.500 m/s, IoU drivable area 0.750, IoU lane boundary 0.500")
    assert MAPS.describe() == "IoU drivable area 0.750"


@pytest.mark.parametrize(
    "changes",
    [
        {"NDS": None, "map_iou": {}},
        {"NDS": "high"},
        {"map_iou": 3},
        {"NDS": float("nan")},
        {"NDS": None, "map_iou": {"a": "x"}},
    ],
)
def test_a_line_without_scores_is_refused(changes):
    line = BOTH.to_dict()
    with pytest.raises(ValueError, match=r"without scores|not finite"):
        ValidationScores.from_dict({**line, "validation": {**line["validation"], **changes}})
    del line["validation"]["data"]
    with pytest.raises(ValueError, match="without scores"):
        ValidationScores.from_dict(line)
