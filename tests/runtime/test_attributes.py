"""The most likely attribute of an object, by its class and speed."""

import numpy as np
import pytest

from duospacenet.runtime.attributes import ATTRIBUTES, likely_attribute, likely_attributes


@pytest.mark.parametrize(
    ("name", "standing", "moving"),
    [
        ("car", "vehicle.parked", "vehicle.moving"),
        ("truck", "vehicle.parked", "vehicle.moving"),
        ("construction_vehicle", "vehicle.parked", "vehicle.moving"),
        ("bus", "vehicle.stopped", "vehicle.moving"),
        ("trailer", "vehicle.parked", "vehicle.moving"),
        ("barrier", "", ""),
        ("motorcycle", "cycle.without_rider", "cycle.with_rider"),
        ("bicycle", "cycle.without_rider", "cycle.with_rider"),
        ("pedestrian", "pedestrian.standing", "pedestrian.moving"),
        ("traffic_cone", "", ""),
        ("tram", "", ""),
    ],
)
def test_the_attribute_follows_from_class_and_speed(name, standing, moving):
    assert (likely_attribute(name, 0.2), likely_attribute(name, 0.3)) == (standing, moving)
    assert {standing, moving} <= {"", *ATTRIBUTES}


def test_the_speed_is_the_length_of_the_velocity_and_may_be_unknown():
    velocities = np.array([[0.15, 0.15], [-0.1, 0.1], [np.nan, 3]], np.float32)
    assert likely_attributes(("car",) * 3, velocities) == ("vehicle.moving", "vehicle.parked", "")
    assert likely_attributes((), np.zeros((0, 2))) == ()
