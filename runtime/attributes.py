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


def likely_attributes(classes: Sequence[str], velocities_m_s: NDArray[np.floating]) -> tuple[str, ...]:
    """Return the most likely attribute of each object, by its class and speed.

    classes: D names. velocities_m_s: (D, 2). An object of unknown speed (NaN) has no attribute.
    """
    speeds_m_s = np.hypot(*velocities_m_s.astype(np.float64).T).tolist()
    return tuple(likely_attribute(name, speed_m_s) for name, speed_m_s in zip(classes, speeds_m_s, strict=True))


def likely_attribute(name: str, speed_m_s: float) -> str:
    """Return the most likely attribute of an object; "" for a class without attributes or an unknown speed (NaN)."""
    if name in ("barrier", "traffic_cone") or speed_m_s != speed_m_s:
        return NO_ATTRIBUTE
    moves = speed_m_s > MOVING_M_S
    if name == "pedestrian":
        return "pedestrian.moving" if moves else "pedestrian.standing"
    if name in ("motorcycle", "bicycle"):
        return "cycle.with_rider" if moves else "cycle.without_rider"
    if name == "bus" and not moves:
        return "vehicle.stopped"
    return "vehicle.moving" if moves else "vehicle.parked"
