"""The five true positive errors of nuScenes: translation, scale, orientation, velocity and attribute."""

import numpy as np
from numpy.typing import NDArray

from .boxes import NO_ATTRIBUTE, EvalBoxes
from .protocol import ErrorName

Array = NDArray[np.float64]


def true_positive_errors(ground_truth: EvalBoxes, detections: EvalBoxes, period_rad: float) -> dict[ErrorName, Array]:
    """The errors (M,) of M detections. Row i of both arguments is a matched pair.

    period_rad: period of the class in yaw, from `heading_period_rad`.

    Returns the errors by name: translation [m], scale, orientation [rad], velocity [m/s], attribute. A velocity error
    is NaN if the true velocity is unknown. An attribute error is NaN if the true box has no attribute.
    """
    true, detected = ground_truth.values.astype(np.float64), detections.values.astype(np.float64)
    is_wrong_attribute = ground_truth.attribute != detections.attribute
    return {
        "translation": np.linalg.norm(detected[:, :2] - true[:, :2], axis=1),
        "scale": 1 - aligned_iou(true[:, 3:6], detected[:, 3:6]),
        "orientation": np.abs(angle_difference(true[:, 6], detected[:, 6], period_rad)),
        "velocity": np.linalg.norm(detected[:, 7:9] - true[:, 7:9], axis=1),
        "attribute": np.where(ground_truth.attribute == NO_ATTRIBUTE, np.nan, is_wrong_attribute),
    }


def aligned_iou(true_size_m: Array, size_m: Array) -> Array:
    """The IoU (M,) of boxes with sizes (M, 3) [m] that have the same centre and heading."""
    intersection = np.prod(np.minimum(true_size_m, size_m), axis=1)
    return intersection / (np.prod(true_size_m, axis=1) + np.prod(size_m, axis=1) - intersection)


def angle_difference(true_rad: Array, rad: Array, period_rad: float) -> Array:
    """The smallest signed angle (M,) from `rad` to `true_rad`, in [-period / 2, period / 2)."""
    return (true_rad - rad + period_rad / 2) % period_rad - period_rad / 2
