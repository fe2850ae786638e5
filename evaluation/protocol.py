"""Constants of the nuScenes detection benchmark: `detection_cvpr_2019`, as in nuscenes-devkit 1.2."""

from typing import Literal, get_args

import numpy as np

CLASS_RANGES_M = {  # only boxes nearer to the ego than this, measured in x and y, are evaluated
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
MATCHING_DISTANCES_M = (0.5, 1.0, 2.0, 4.0)  # between the centres of matched boxes, below this; the devkit's dist_ths
ERROR_DISTANCE_M = 2.0  # the matching distance of the true positive errors; the devkit's dist_th_tp
NUM_RECALLS = 101
MIN_RECALL = 0.1
MIN_PRECISION = 0.1
MEAN_AP_WEIGHT = 5  # of mAP in the NDS; each of the five errors has weight 1

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
    """The period of a class in yaw: pi for a barrier, which looks the same from both sides, otherwise 2 pi."""
    return np.pi if name == "barrier" else 2 * np.pi
