"""Precision, confidence and true positive errors over recall, for one class and one matching distance.

The steps and their order are those of nuscenes-devkit (`accumulate`, `calc_ap`, `calc_tp`). This includes `np.interp`
over repeated recalls: if detections have the same recall, the last one counts.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .protocol import ERRORS, MIN_PRECISION, MIN_RECALL, NUM_RECALLS, ErrorName

Array = NDArray[np.float64]

RECALL: Array = np.linspace(0, 1, NUM_RECALLS)
_FIRST_INDEX = round((NUM_RECALLS - 1) * MIN_RECALL) + 1  # of RECALL; the devkit excludes the minimum recall itself


@dataclass(frozen=True)
class PrecisionCurve:
    """Values at the 101 recalls of RECALL.

    precision: (101,).
    confidence: (101,) score of the detection at which each recall is reached; 0 where it is not reached.
    errors: (101,) by name: means over the true positives up to each recall.
    """

    precision: Array
    confidence: Array
    errors: Mapping[ErrorName, Array]

    @classmethod
    def from_matches(
        cls, score: Array, is_match: NDArray[np.bool_], errors: Mapping[ErrorName, Array], num_truth: int
    ) -> "PrecisionCurve":
        """The curve of D detections of one class.

        score: (D,) descending.
        is_match: (D,) whether each detection is a true positive.
        errors: (M,) by name, of the true positives, in the same order.
        num_truth: number of ground-truth boxes.

        Without ground truth or without a match, the result is that of `no_predictions`.
        """
        if num_truth == 0 or not is_match.any():
            return cls.no_predictions()
        true_positives = np.cumsum(is_match).astype(np.float64)
        precision = true_positives / np.arange(1, len(is_match) + 1)
        recall = true_positives / num_truth
        confidence = np.interp(RECALL, recall, score, right=0)
        return cls(
            precision=np.interp(RECALL, recall, precision, right=0),
            confidence=confidence,
            # np.interp needs ascending x values, but scores descend: both are reversed, and the result back again.
            errors={
                name: np.interp(confidence[::-1], score[is_match][::-1], cumulative_mean(values)[::-1])[::-1]
                for name, values in errors.items()
            },
        )

    @classmethod
    def no_predictions(cls) -> "PrecisionCurve":
        """The curve of no detections: precision 0 and errors 1."""
        zeros, ones = np.zeros(NUM_RECALLS), np.ones(NUM_RECALLS)
        return cls(zeros, zeros, dict.fromkeys(ERRORS, ones))

    @property
    def max_recall_index(self) -> int:
        """Index of the largest recall that is reached: the last one with a confidence above 0."""
        reached = np.flatnonzero(self.confidence)
        return int(reached[-1]) if len(reached) else 0

    @property
    def average_precision(self) -> float:
        """The mean of max(0, precision - 0.1) over the recalls above 0.1, scaled so that 1 is perfect."""
        above_minimum = np.maximum(self.precision[_FIRST_INDEX:] - MIN_PRECISION, 0)
        return float(np.mean(above_minimum)) / (1 - MIN_PRECISION)

    def mean_error(self, name: ErrorName) -> float:
        """The mean error from recall 0.11 up to the largest recall reached; 1 if that is at most 0.1."""
        if self.max_recall_index < _FIRST_INDEX:
            return 1.0
        return float(np.mean(self.errors[name][_FIRST_INDEX : self.max_recall_index + 1]))


def cumulative_mean(values: Array) -> Array:
    """The mean (M,) of all values up to each one. NaN is ignored.

    As in the devkit's `cummean`, the mean is 0 before the first number, and 1 everywhere if all values are NaN.
    """
    is_number = ~np.isnan(values)
    if not is_number.any():
        return np.ones(len(values))
    counts = np.cumsum(is_number)
    return np.divide(np.nancumsum(values), counts, out=np.zeros(len(values)), where=counts != 0)
