"""The selection of ground-truth boxes, and the sentences about those left out."""

import numpy as np
import pytest

from duospacenet.data.box_counts import BoxCounts
from duospacenet.data.box_selection import select_boxes, total_counts
from duospacenet.data.class_names import DETECTION_CLASSES
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.frame import GroundTruth

NAMES = ("car", "vehicle.car", "animal", "vehicle.car", "Tram", "bus")


def ground_truth(names=NAMES, **fields):
    boxes = np.arange(9.0 * len(names)).reshape(-1, 9)
    return GroundTruth(boxes, tuple(names), class_mapping={"Tram": None}, **fields)


def test_rows_boxes_and_classes_belong_together():
    selection = select_boxes(ground_truth(), DETECTION_CLASSES)
    assert selection.rows.tolist() == [0, 1, 3, 5]
    assert selection.classes == ("car", "car", "car", "bus")
    assert selection.boxes[:, 0].tolist() == [0, 9, 27, 45]


def test_boxes_are_left_out_for_one_reason_after_the_other():
    selection = select_boxes(ground_truth(num_points=np.array([5, 0, 0, -1, 0, 3])), DETECTION_CLASSES)
    selection = selection.keep(np.array([True, True, True, False]), "range").keep_observed()
    assert selection.rows.tolist() == [0, 3]
    assert selection.classes == ("car", "car")
    assert selection.counts == BoxCounts(
        used={"car": 2},
        mapped={("vehicle.car", "car"): 1},
        left_out={("class", "animal"): 1, ("class", "Tram"): 1, ("range", "bus"): 1, ("no_points", "vehicle.car"): 1},
    )


def test_attributes_stay_with_their_boxes():
    attributes = ("vehicle.moving", "vehicle.parked", "", "vehicle.stopped", "", "vehicle.stopped")
    selection = select_boxes(ground_truth(attributes=attributes), DETECTION_CLASSES)
    assert selection.attributes == ("vehicle.moving", "vehicle.parked", "vehicle.stopped", "vehicle.stopped")
    selection = selection.keep(np.array([False, True, False, True]), "range")
    assert selection.attributes == ("vehicle.parked", "vehicle.stopped")
    assert select_boxes(ground_truth(), DETECTION_CLASSES).attributes is None


def test_the_counts_of_frames_are_added():
    frames = [ground_truth(), ground_truth(["animal", "truck"]), ground_truth([])]
    counts = total_counts(select_boxes(frame, DETECTION_CLASSES) for frame in frames)
    assert counts.num_used == 5
    assert counts.left_out.total() == 3
    assert counts.used == {"car": 3, "bus": 1, "truck": 1}
    assert counts.left_out == {("class", "animal"): 2, ("class", "Tram"): 1}


def test_the_lines_say_how_many_boxes_were_mapped_and_left_out_and_why():
    selection = select_boxes(ground_truth(num_points=np.array([5, 0, 0, -1, 0, 3])), DETECTION_CLASSES)
    counts = selection.keep(np.array([True, True, True, False]), "range").keep_observed().counts
    assert list(counts.lines()) == [
        "mapped 1 box to classes: vehicle.car -> car (1)",
        "left out 2 boxes of other classes: animal (1), Tram (1)",
        "left out 1 box out of range: bus (1)",
        "left out 1 box without lidar or radar points: vehicle.car (1)",
    ]
    assert counts.to_dict() == {
        "boxes": 2,
        "mapped": {"vehicle.car": {"car": 1}},
        "left_out": {"class": {"animal": 1, "Tram": 1}, "range": {"bus": 1}, "no_points": {"vehicle.car": 1}},
    }


def test_a_line_never_holds_control_characters():
    named = GroundTruth(np.ones((1, 9)), ("\x1b[2J\ud800",), class_mapping={"\x1b[2J\ud800": None})
    (line,) = select_boxes(named, DETECTION_CLASSES).counts.lines()
    assert line.isascii()
    assert line.isprintable()


def test_unknown_names_are_refused_with_their_place_and_counts():
    with pytest.raises(InputError, match=r"^frame 7: expected .*; got 'Car' \(2 boxes\)\. Rename"):
        select_boxes(ground_truth(["Car", "car", "Car"]), DETECTION_CLASSES, "frame 7")
