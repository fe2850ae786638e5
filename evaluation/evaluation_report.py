"""What an evaluation found: numbers by class, and their means."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .precision_curve import PrecisionCurve
from .protocol import ERROR_DISTANCE_M, ERRORS, MEAN_AP_WEIGHT, UNDEFINED_ERRORS, ErrorName


@dataclass(frozen=True)
class ClassReport:
    """One class. num_truth, num_detections: boxes within the class's range. curves: by matching distance [m]."""

    name: str
    num_truth: int
    num_detections: int
    curves: Mapping[float, PrecisionCurve]

    @property
    def average_precisions(self) -> dict[float, float]:
        """By matching distance [m]."""
        return {distance_m: curve.average_precision for distance_m, curve in self.curves.items()}

    @property
    def mean_average_precision(self) -> float:
        """The mean over the matching distances."""
        return float(np.mean(list(self.average_precisions.values())))

    @property
    def errors(self) -> dict[ErrorName, float]:
        """The true positive errors; NaN for those that the class does not have, 1 where nothing was found."""
        curve, undefined = self.curves[ERROR_DISTANCE_M], UNDEFINED_ERRORS.get(self.name, ())
        return {name: float("nan") if name in undefined else curve.mean_error(name) for name in ERRORS}


@dataclass(frozen=True)
class EvaluationReport:
    """All classes of the benchmark, in its order, whether there is a truth of them or not.

    map_iou: by map class; empty where no map was drawn, or none is known. ignored: true boxes of classes that the
    benchmark does not have, by class.
    """

    num_samples: int
    classes: tuple[ClassReport, ...]
    map_iou: Mapping[str, float]
    ignored: Mapping[str, int]

    @property
    def mean_average_precision(self) -> float:
        """mAP: the mean over the classes. One without any truth counts as 0, as in the benchmark."""
        return float(np.mean([one.mean_average_precision for one in self.classes]))

    @property
    def mean_errors(self) -> dict[ErrorName, float]:
        """mATE, mASE, ...: the means over the classes that have the error."""
        return {name: float(np.nanmean([one.errors[name] for one in self.classes])) for name in ERRORS}

    @property
    def nds(self) -> float:
        """The nuScenes detection score: mAP and what the mean errors leave of 1, weighted."""
        scores = [max(0.0, 1.0 - error) for error in self.mean_errors.values()]
        return (MEAN_AP_WEIGHT * self.mean_average_precision + sum(scores)) / (MEAN_AP_WEIGHT + len(scores))

    def to_dict(self) -> dict[str, Any]:
        """As JSON values, None for NaN."""
        return {
            "samples": self.num_samples,
            "mAP": self.mean_average_precision,
            "NDS": self.nds,
            "errors": _finite(self.mean_errors),
            "map_iou": _finite(self.map_iou),
            "classes": {
                one.name: {
                    "truth": one.num_truth,
                    "detections": one.num_detections,
                    "AP": {f"{distance_m:g}": value for distance_m, value in one.average_precisions.items()},
                    "mean_AP": one.mean_average_precision,
                    "errors": _finite(one.errors),
                }
                for one in self.classes
            },
            "ignored": dict(self.ignored),
        }


def _finite(values: Mapping[Any, float]) -> dict[str, float | None]:
    return {str(name): value if np.isfinite(value) else None for name, value in values.items()}
