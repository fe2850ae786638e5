"""The category of each object: most stand for the object's class, a few belong to no class of the benchmark."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

Rng = np.random.Generator


class Category(NamedTuple):
    """A category and how often an object of a class has it.

    share: of the objects of the class, 0..1.
    """

    name: str
    share: float


CATEGORIES: Mapping[str, Sequence[Category]] = {
    "car": [Category("vehicle.car", 0.96), Category("vehicle.emergency.police", 0.04)],
    "truck": [Category("vehicle.truck", 0.96), Category("vehicle.emergency.ambulance", 0.04)],
    "construction_vehicle": [Category("vehicle.construction", 1.0)],
    "bus": [Category("vehicle.bus.rigid", 0.8), Category("vehicle.bus.bendy", 0.2)],
    "trailer": [Category("vehicle.trailer", 1.0)],
    "barrier": [Category("movable_object.barrier", 0.97), Category("movable_object.pushable_pullable", 0.03)],
    "motorcycle": [Category("vehicle.motorcycle", 1.0)],
    "bicycle": [Category("vehicle.bicycle", 1.0)],
    "pedestrian": [
        Category("human.pedestrian.adult", 0.82),
        Category("human.pedestrian.child", 0.05),
        Category("human.pedestrian.construction_worker", 0.05),
        Category("human.pedestrian.police_officer", 0.02),
        Category("human.pedestrian.personal_mobility", 0.02),
        Category("human.pedestrian.stroller", 0.02),
        Category("human.pedestrian.wheelchair", 0.02),
    ],
    "traffic_cone": [Category("movable_object.trafficcone", 0.97), Category("movable_object.debris", 0.03)],
}


def choose_category(name: str, rng: Rng) -> str:
    """The category of an object of a class."""
    categories = CATEGORIES[name]
    return categories[int(rng.choice(len(categories), p=[category.share for category in categories]))].name
