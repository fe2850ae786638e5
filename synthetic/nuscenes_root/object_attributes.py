"""The annotated attribute of each object, by its motion and by chance.

Motion alone does not decide: a stationary vehicle may be parked, stopped or at work. So a detector that derives
attributes from class and speed makes errors here, as it does on nuScenes.
"""

import numpy as np

from .annotated_object import AnnotatedObject

Rng = np.random.Generator

ATTRIBUTES = {
    "vehicle.moving": "The vehicle moves.",
    "vehicle.stopped": "The vehicle is stationary, with a driver who may drive on.",
    "vehicle.parked": "The vehicle is stationary and left by its driver.",
    "cycle.with_rider": "Somebody rides the bicycle or motorcycle.",
    "cycle.without_rider": "Nobody rides the bicycle or motorcycle.",
    "pedestrian.sitting_lying_down": "The person sits or lies.",
    "pedestrian.standing": "The person stands.",
    "pedestrian.moving": "The person walks.",
}
MOVING_M_S = 0.2
UNKNOWN_SHARE = 0.02  # of the objects with an attribute whose annotation has none


def choose_attribute(item: AnnotatedObject, rng: Rng) -> str:
    """The attribute of an object, or "" for none.

    rng: the same stream for the same object in all frames, so that the choice changes only with the motion.
    """
    chance, unknown = rng.random(2)
    names = _attributes(item, chance)
    return "" if unknown < UNKNOWN_SHARE else names


def _attributes(item: AnnotatedObject, chance: float) -> str:
    is_moving = bool(np.hypot(*item.box[7:9]) > MOVING_M_S)
    if item.category in ("vehicle.bicycle", "vehicle.motorcycle"):
        return "cycle.with_rider" if is_moving else "cycle.without_rider"
    if item.category.startswith("vehicle."):
        if is_moving:
            return "vehicle.moving" if chance < 0.97 else "vehicle.stopped"
        if item.category == "vehicle.construction":  # an excavator at work turns on the spot
            return "vehicle.moving" if chance < 0.5 else "vehicle.stopped"
        return "vehicle.parked" if chance < 0.75 else "vehicle.stopped"
    if item.category.startswith("human.pedestrian."):
        if is_moving:
            return "pedestrian.moving" if chance < 0.97 else "pedestrian.standing"
        return "pedestrian.standing" if chance < 0.8 else "pedestrian.sitting_lying_down"
    return ""
