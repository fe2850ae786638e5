"""The rendering order of boxes, by hand-worked cases."""

import numpy as np
import pytest

from duospacenet.synthetic.occlusion_order import OcclusionOrder
from tests.helpers.synthetic_scenes import box_at

EYE = np.zeros(2)


@pytest.mark.parametrize("names", [("near", "far"), ("far", "near")])
def test_the_nearer_of_two_cars_comes_last(names):
    boxes = {"near": box_at("car", 10.0, 0.0), "far": box_at("car", 20.0, 0.0)}
    order = OcclusionOrder(np.array([boxes[name] for name in names])).far_to_near(np.arange(2), EYE)
    assert [names[i] for i in order] == ["far", "near"]


def test_a_pedestrian_behind_a_long_bus_comes_before_it_although_its_centre_is_nearer():
    bus, pedestrian = box_at("bus", 16.0, -4.0), box_at("pedestrian", 13.5, -6.4)
    assert np.hypot(*pedestrian[:2]) < np.hypot(*bus[:2])
    assert OcclusionOrder(np.array([bus, pedestrian])).far_to_near(np.arange(2), EYE).tolist() == [1, 0]


def test_only_the_candidates_are_sorted():
    boxes = np.array([box_at("car", x, 0.0) for x in (10.0, 30.0, 20.0)])
    assert OcclusionOrder(boxes).far_to_near(np.array([0, 2]), EYE).tolist() == [2, 0]
