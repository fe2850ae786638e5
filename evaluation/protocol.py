"""What nuScenes' detection benchmark fixes: `detection_cvpr_2019`, as nuscenes-devkit 1.2 has it."""

from typing import Literal, get_args

import numpy as np

CLASS_RANGES_M = {  # boxes of a class whose centre is farther from the ego, in x and y, do not count
    "car": 50.0,
    "truck": 50.0,
    "bus": 50.0,
    "trailer": 50.0,
    "construction_vehicle": 50.0,
    "pedestrian": 40.0,
    "motorcycle": 40.0,
    "bicycle": 40.0,
    "traffic_cone": 30.0,
    "barrier": 30.0,
}
CLASSES = tuple(CLASS_RANGES_M)
MATCHING_DISTANCES_M = (0.5, 1.0, 2.0, 4.0)  # a detection nearer to a truth than this finds it
ERROR_DISTANCE_M = 2.0  # the one of them that the errors are measured at
NUM_RECALLS = 101
MIN_RECALL = 0.1
MIN_PRECISION = 0.1
MEAN_AP_WEIGHT = 5  # in the NDS, where each of the errors weighs 1

ErrorName = Literal["translation", "scale", "orientation", "velocity", "attribute"]
ERRORS: tuple[ErrorName, ...] = get_args(ErrorName)
ABBREVIATIONS: dict[ErrorName, str] = {
    "translation": "ATE",
    "scale": "ASE",
    "orientation": "AOE",
    "velocity": "AVE",
    "attribute": "AAE",
}
UNITS: dict[ErrorName, str] = {"translation": "[m]", "orientation": "[rad]", "velocity": "[m/s]"}
UNDEFINED_ERRORS: dict[str, tuple[ErrorName, ...]] = {
    "traffic_cone": ("orientation", "velocity", "attribute"),
    "barrier": ("velocity", "attribute"),
}


def heading_period_rad(name: str) -> float:
    """The turn after which an object of class `name` looks the same."""
    return np.pi if name == "barrier" else 2 * np.pi
