"""Objects behind other objects are not visible."""

import numpy as np

from duospacenet.synthetic.visibility import is_box_visible
from tests.helpers.synthetic_scenes import box_at, render


def test_a_car_behind_a_bus_is_not_visible():
    bus, hidden, beside = box_at("bus", 15.0, 0.0, np.pi / 2), box_at("car", 24.0, 0.0), box_at("car", 24.0, 14.0)
    rendered, _ = render((400, 160), ["car", "bus", "car"], [hidden, bus, beside])
    assert is_box_visible(list(rendered.values())).tolist() == [False, True, True]


def test_a_pedestrian_behind_a_long_bus_is_hidden_although_its_centre_is_nearer():
    bus, pedestrian = box_at("bus", 16.0, -4.0), box_at("pedestrian", 13.5, -6.4)
    assert np.hypot(*pedestrian[:2]) < np.hypot(*bus[:2])
    rendered, _ = render((400, 160), ["bus", "pedestrian"], [bus, pedestrian])
    assert is_box_visible([rendered["CAM_FRONT"]]).tolist() == [True, False]
