"""The attributes of nuScenes, such as `vehicle.parked`, and the most likely one of a detected object.

The names are `ATTRIBUTE_NAMES` of nuscenes-devkit 1.2.0 (nuscenes/eval/detection/constants.py).
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

ATTRIBUTES = (
    "pedestrian.moving",
    "pedestrian.sitting_lying_down",
    "pedestrian.standing",
    "cycle.with_rider",
    "cycle.without_rider",
    "vehicle.moving",
    "vehicle.parked",
    "vehicle.stopped",
)
NO_ATTRIBUTE = ""
MOVING_M_S = 0.2  # a faster object counts as moving

_BY_MOTION = {  # of a standing and of a moving object
    "car": ("vehicle.parked", "vehicle.moving"),
    "truck": ("vehicle.parked", "vehicle.moving"),
    "trailer": ("vehicle.parked", "vehicle.moving"),
    "construction_vehicle": ("vehicle.parked", "vehicle.moving"),
    "bus": ("vehicle.stopped", "vehicle.moving"),
    "motorcycle": ("cycle.without_rider", "cycle.with_rider"),
    "bicycle": ("cycle.without_rider", "cycle.with_rider"),
    "pedestrian": ("pedestrian.standing", "pedestrian.moving"),
}


def likely_attributes(classes: Sequence[str], velocities_m_s: NDArray[np.floating]) -> tuple[str, ...]:
    """Return the most likely attribute of each object, by its class and speed.

    classes: D names. velocities_m_s: (D, 2). An object of unknown speed (NaN) has no attribute.
    """
    speeds_m_s = np.hypot(*velocities_m_s.astype(np.float64).T).tolist()
    return tuple(likely_attribute(name, speed_m_s) for name, speed_m_s in zip(classes, speeds_m_s, strict=True))


def likely_attribute(name: str, speed_m_s: float) -> str:
    """Return the most likely attribute of an object.

    It is "" for barriers and traffic cones, for classes that nuScenes does not have, and if the speed is unknown (NaN).
    """
    if speed_m_s != speed_m_s:
        return NO_ATTRIBUTE
    when_standing, when_moving = _BY_MOTION.get(name, (NO_ATTRIBUTE, NO_ATTRIBUTE))
    return when_moving if speed_m_s > MOVING_M_S else when_standing
