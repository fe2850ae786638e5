"""Checks of ground-truth boxes: right boxes have no finding, and too few boxes are not judged."""

import numpy as np
import pytest

from duospacenet.rig import Verdict
from duospacenet.rig.ground_truth_checks import box_findings, boxes_not_judged, name_findings
from duospacenet.rig.labelled_frame import LabelledFrame
from duospacenet.runtime.frame import Frame, GroundTruth
from duospacenet.runtime.geometry import rigid_transform

CARS = [
    (10.0, 4.0, 0.85),
    (22.0, -4.0, 0.85),
    (35.0, 4.5, 0.85),
    (-12.0, -3.5, 0.85),
    (18.0, 9.0, 0.85),
    (30.0, -9.0, 0.85),
]  # at rest
STEP_M = 4.0


def labelled(change=lambda box: box, names=("car",) * 6, num_cars=6):
    """Two frames with parked cars, while the vehicle drives 4 m along x."""
    frames = []
    for index in range(2):
        frame = Frame({}, {}, rigid_transform(np.eye(3), [600 + STEP_M * index, 1600, 0]), index / 2, "scene")
        boxes = [[x - STEP_M * index, y, z, 1.9, 4.6, 1.7, 0.0, 0.0, 0.0] for x, y, z in CARS[:num_cars]]
        truth = GroundTruth(np.array([change(np.array(box)) for box in boxes]), names[:num_cars])
        frames.append(LabelledFrame.of(index, frame, truth))
    return frames


def test_right_boxes_have_no_finding():
    assert box_findings(labelled()) == []


def lower(box):
    box[2] -= 0.85
    return box


def exchange(box):
    box[[3, 4]] = box[[4, 3]]
    return box


def turn_axes(box):
    box[[0, 1]] = -box[1], box[0]
    return box


def to_global(box):
    box[:2] += 600, 1600
    return box


@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lower, "those of the bottoms"),
        (exchange, "width and length are exchanged"),
        (turn_axes, "x right, y forward"),
        (lambda box: np.where(np.arange(9) == 6, 90.0, box), "yaws are in degrees"),
    ],
)
def test_a_mistake_in_all_boxes_is_named(change, cause):
    (finding,) = box_findings(labelled(change))
    assert finding.verdict is Verdict.SUSPECT
    assert cause in finding.cause


def test_few_boxes_are_not_judged():
    assert box_findings(labelled(exchange, num_cars=1)) == []
    (not_judged,) = boxes_not_judged(labelled(num_cars=1))
    assert not_judged.reason == "only 2 in the 2 checked frames"
    assert boxes_not_judged([]) == []


def test_unknown_names_are_broken_and_mapped_ones_are_not():
    boxes = np.zeros((2, 9))
    (finding,) = name_findings([(3, GroundTruth(boxes, ("Car", "car")))])
    assert (finding.verdict, finding.frame) == (Verdict.BROKEN, 3)
    assert "1 boxes with other names: 'Car' (1)" in finding.got
    assert name_findings([(3, GroundTruth(boxes, ("Car", "car"), class_mapping={"Car": "car"}))]) == []
    assert name_findings([(3, GroundTruth(boxes, ("vehicle.car", "animal")))]) == []
