"""What a class looks like over recall, at one limit: precision, confidence and errors, and the numbers made of them.

The steps and their order are nuscenes-devkit's (`accumulate`, `calc_ap`, `calc_tp`), `np.interp` over repeating
recalls included: where a recall repeats, the last precision counts.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .protocol import ERRORS, MIN_PRECISION, MIN_RECALL, NUM_RECALLS, ErrorName

Array = NDArray[np.float64]

RECALL: Array = np.linspace(0, 1, NUM_RECALLS)
_FIRST = round((NUM_RECALLS - 1) * MIN_RECALL) + 1  # the least recall itself does not count


@dataclass(frozen=True)
class PrecisionCurve:
    """precision, confidence and each of the errors: (101,), at the recalls RECALL."""

    precision: Array
    confidence: Array
    errors: Mapping[ErrorName, Array]

    @classmethod
    def of(cls, score: Array, hit: NDArray[np.bool_], errors: Mapping[ErrorName, Array], num_truth: int) -> "Curve":
        """The curve of D detections of one class.

        score: (D,) descending. hit: (D,) whether each found a truth. errors: (M,) of those that did, in their order.
        Without a truth or a hit it is that of no detections: errors of 1.
        """
        if num_truth == 0 or not hit.any():
            return cls.of_nothing()
        true_positives = np.cumsum(hit).astype(np.float64)
        precision = true_positives / np.arange(1, len(hit) + 1)
        recall = true_positives / num_truth
        confidence = np.interp(RECALL, recall, score, right=0)
        return cls(
            precision=np.interp(RECALL, recall, precision, right=0),
            confidence=confidence,
            errors={
                name: np.interp(confidence[::-1], score[hit][::-1], cumulative_mean(values)[::-1])[::-1]
                for name, values in errors.items()
            },
        )

    @classmethod
    def of_nothing(cls) -> "Curve":
        nothing, worst = np.zeros(NUM_RECALLS), np.ones(NUM_RECALLS)
        return cls(nothing, nothing, dict.fromkeys(ERRORS, worst))

    @property
    def last_reached(self) -> int:
        """Index of the largest recall that is reached: the last whose confidence is above 0."""
        reached = np.flatnonzero(self.confidence)
        return int(reached[-1]) if len(reached) else 0

    @property
    def average_precision(self) -> float:
        """The mean precision above the least one, over the recalls above the least one; 1 is perfect."""
        counted = np.maximum(self.precision[_FIRST:] - MIN_PRECISION, 0)
        return float(np.mean(counted)) / (1 - MIN_PRECISION)

    def mean_error(self, name: ErrorName) -> float:
        """The mean of an error over the recalls from the least to the largest one reached; 1 where that is less."""
        if self.last_reached < _FIRST:
            return 1.0
        return float(np.mean(self.errors[name][_FIRST : self.last_reached + 1]))


def cumulative_mean(values: Array) -> Array:
    """(M,) the mean of the values up to each one; NaN does not count. 0 before the first number, 1 if all are NaN."""
    known = ~np.isnan(values)
    if not known.any():
        return np.ones(len(values))
    counts = np.cumsum(known)
    return np.divide(np.nancumsum(values), counts, out=np.zeros(len(values)), where=counts != 0)
