"""True objects that a result contains, in cases worked by hand."""

import numpy as np

from duospacenet.evaluation.found_objects import find_objects


def boxes(*centres):
    return np.array([[x, y, 0, 2, 4, 2, 0, 0, 0] for x, y in centres], float).reshape(-1, 9)


def test_an_object_is_found_by_a_box_of_its_class_within_two_metres():
    truth = boxes((10, 0), (20, 0), (30, 0))
    detected = boxes((11.9, 0), (22.1, 0), (30, 0))
    found = find_objects(truth, ["car"] * 3, detected, np.ones(3), ["car", "car", "bus"])
    assert found.tolist() == [True, False, False]


def test_one_box_finds_one_object_only():
    found = find_objects(boxes((10, 0), (11, 0)), ["car", "car"], boxes((10.9, 0)), np.ones(1), ["car"])
    assert found.tolist() == [False, True]


def test_the_box_with_the_higher_score_chooses_first():
    # The box at 11 would take the object at 10.8, and leave none within 2 m for the one at 12.5.
    truth, detected = boxes((8.5, 0), (10.8, 0)), boxes((11, 0), (12.5, 0))
    assert find_objects(truth, ["car"] * 2, detected, np.array([0.9, 0.5]), ["car"] * 2).tolist() == [False, True]
    truth = boxes((9.3, 0), (10.8, 0))
    assert find_objects(truth, ["car"] * 2, detected, np.array([0.5, 0.9]), ["car"] * 2).tolist() == [True, True]


def test_results_and_frames_without_boxes_are_accepted():
    assert find_objects(boxes((1, 1)), ["car"], boxes(), np.zeros(0), []).tolist() == [False]
    assert find_objects(boxes(), [], boxes((1, 1)), np.ones(1), ["car"]).tolist() == []
