"""The boxes that nuScenes' benchmark leaves out: racks, points and ranges."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.evaluation import Sample, evaluate
from duospacenet.evaluation.box_filter import is_in_rack, select_true_boxes
from duospacenet.runtime.errors import InputError
from duospacenet.runtime.geometry import box_corners
from tests.helpers.evaluation_samples import box, make_detections, make_ground_truth

RACK = "static_object.bicycle_rack"


def is_in_box(corners, point):
    """nuscenes-devkit's `points_in_box`: projections on the three edges that meet in one corner, faces included."""
    corner, *ends = corners[[2, 1, 3, 6]]  # rear right; front right, rear left, and above
    edges = [end - corner for end in ends]
    return all(0 <= edge @ (point - corner) <= edge @ edge for edge in edges)


def test_a_centre_is_in_a_rack_by_the_rule_of_the_devkit():
    rng = np.random.default_rng(0)
    racks = np.concatenate(
        [rng.uniform(-3, 3, (20, 3)), rng.uniform(0.5, 6, (20, 3)), rng.uniform(-4, 4, (20, 3))], axis=1
    )
    boxes = np.concatenate([rng.uniform(-5, 5, (60, 3)), np.ones((60, 6))], axis=1)
    for rack in racks:
        (corners,) = box_corners(rack)
        expected = [is_in_box(corners, centre) for centre in boxes[:, :3]]
        assert is_in_rack(boxes, ["bicycle"] * 60, rack[None]).tolist() == expected
    any_rack = [any(is_in_box(corners, centre) for corners in box_corners(racks)) for centre in boxes[:, :3]]
    assert 5 < sum(any_rack) < 60
    assert is_in_rack(boxes, ["motorcycle"] * 60, racks).tolist() == any_rack


def test_only_bicycles_and_motorcycles_are_left_out_in_racks():
    """The rack is 2 m wide and 6 m long. Its centre is at x = 10 m, its length along x. The last bicycle is outside."""
    names = [RACK, "bicycle", "vehicle.motorcycle", "pedestrian", "bicycle"]
    places = [box(10, 0, (2, 6, 1.5)), box(8), box(12.9), box(10), box(13.1)]
    selection = select_true_boxes(make_ground_truth(places, names), "x")
    assert selection.rows.tolist() == [3, 4]
    assert selection.counts.left_out == {
        ("class", RACK): 1,
        ("bicycle_rack", "bicycle"): 1,
        ("bicycle_rack", "vehicle.motorcycle"): 1,
    }


def test_a_rack_under_another_name_counts_if_the_mapping_says_so():
    ground_truth = make_ground_truth([box(10, 0, (2, 6, 1.5)), box(10)], ["BikeStand", "bicycle"])
    mapped = replace(ground_truth, class_mapping={"BikeStand": RACK})
    assert select_true_boxes(mapped, "x").rows.tolist() == []
    ignored = replace(ground_truth, class_mapping={"BikeStand": None})
    assert select_true_boxes(ignored, "x").rows.tolist() == [1]


def test_detections_in_racks_are_left_out_too():
    """Without the rule, the detection in the rack would be a false positive with the highest score."""
    truth = make_ground_truth([box(10, 0, (2, 6, 1.5)), box(10), box(20)], [RACK, "bicycle", "bicycle"])
    detections = make_detections([box(10), box(20), box(10)], [0.9, 0.5, 0.8], ["bicycle", "bicycle", "car"])
    report = evaluate([Sample(detections, truth)])
    bicycle = next(one for one in report.classes if one.name == "bicycle")
    assert (bicycle.num_truth, bicycle.num_detections) == (1, 1)
    assert bicycle.mean_average_precision == pytest.approx(1)
    assert next(one for one in report.classes if one.name == "car").num_detections == 1


def test_racks_of_one_sample_do_not_hide_boxes_of_another():
    with_rack = Sample(make_detections([], [], []), make_ground_truth([box(10, 0, (9, 9, 9))], [RACK]))
    with_bicycle = Sample(make_detections([], [], []), make_ground_truth([box(10)], ["bicycle"]))
    report = evaluate([with_rack, with_bicycle])
    assert report.ground_truth.used == {"bicycle": 1}


def test_boxes_without_points_and_beyond_their_range_are_left_out_and_counted():
    """Zero points are left out; an unknown number (-1) is not. 45 m is in the range of a car, not of a pedestrian."""
    names = ["car", "vehicle.car", "car", "pedestrian", "animal"]
    truth = make_ground_truth([box(1), box(2), box(45), box(45), box(3)], names)
    report = evaluate([Sample(make_detections([], [], []), replace(truth, num_points=np.array([1, 0, -1, 4, 0])))])
    assert report.ground_truth.used == {"car": 2}
    assert report.to_dict()["ground_truth"] == {
        "boxes": 2,
        "mapped": {},
        "left_out": {"class": {"animal": 1}, "range": {"pedestrian": 1}, "no_points": {"vehicle.car": 1}},
    }


def test_attributes_stay_with_their_boxes():
    """The first true box is left out. The second one has the attribute of the detection, so its error is 0."""
    truth = make_ground_truth([box(30), box(10)], ["animal", "car"], ["vehicle.moving", "vehicle.parked"])
    sample = Sample(make_detections([box(10)], [0.9], ["car"]), truth)
    assert next(one for one in evaluate([sample]).classes if one.name == "car").errors["attribute"] == 0


def test_unknown_names_are_refused_with_the_number_of_the_sample():
    empty = make_detections([], [], [])
    with pytest.raises(InputError, match=r"sample 1: ground truth: expected class names .*; got 'Car' \(1 box\)"):
        evaluate([Sample(empty, make_ground_truth([], [])), Sample(empty, make_ground_truth([box()], ["Car"]))])


def test_numbers_of_points_of_another_length_are_refused():
    truth = replace(make_ground_truth([box()], ["car"]), num_points=np.zeros(2, np.int64))
    with pytest.raises(InputError, match=r"sample 0: ground truth: expected num_points of shape \(1,\).*got \(2,\)"):
        evaluate([Sample(make_detections([], [], []), truth)])
