"""How far a detection is off the truth that it found: the five true positive errors of nuScenes."""

import numpy as np
from numpy.typing import NDArray

from .boxes import NO_ATTRIBUTE, EvalBoxes
from .protocol import ErrorName

Array = NDArray[np.float64]


def true_positive_errors(ground_truth: EvalBoxes, found: EvalBoxes, period_rad: float) -> dict[ErrorName, Array]:
    """The errors (M,) of M detections and the truths that they found, row by row.

    period_rad: the turn after which an object of the class looks the same. Velocity is NaN where the truth's is, and
    attribute where the truth has none.
    """
    true, detected = ground_truth.values.astype(np.float64), found.values.astype(np.float64)
    return {
        "translation": np.linalg.norm(detected[:, :2] - true[:, :2], axis=1),
        "scale": 1 - aligned_iou(true[:, 3:6], detected[:, 3:6]),
        "orientation": np.abs(angle_difference(true[:, 6], detected[:, 6], period_rad)),
        "velocity": np.linalg.norm(detected[:, 7:9] - true[:, 7:9], axis=1),
        "attribute": np.where(
            ground_truth.attribute == NO_ATTRIBUTE, np.nan, ground_truth.attribute != found.attribute
        ),
    }


def aligned_iou(true_size_m: Array, size_m: Array) -> Array:
    """(M,) intersection over union of boxes of sizes (M, 3) that share centre and heading."""
    intersection = np.prod(np.minimum(true_size_m, size_m), axis=1)
    return intersection / (np.prod(true_size_m, axis=1) + np.prod(size_m, axis=1) - intersection)


def angle_difference(true_rad: Array, rad: Array, period_rad: float) -> Array:
    """(M,) the smallest turn from `rad` to `true_rad`, in [-period / 2, period / 2)."""
    return (true_rad - rad + period_rad / 2) % period_rad - period_rad / 2
