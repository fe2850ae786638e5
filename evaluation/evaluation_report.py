"""The result of an evaluation: metrics per class, and their means."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..data.box_counts import BoxCounts
from .precision_curve import PrecisionCurve
from .protocol import ERROR_DISTANCE_M, ERRORS, MEAN_AP_WEIGHT, UNDEFINED_ERRORS, ErrorName


@dataclass(frozen=True)
class ClassReport:
    """The metrics of one class.

    num_truth, num_detections: number of ground-truth and detected boxes within the range of the class.
    curves: precision over recall, by matching distance [m].
    """

    name: str
    num_truth: int
    num_detections: int
    curves: Mapping[float, PrecisionCurve]

    @property
    def average_precisions(self) -> dict[float, float]:
        """Average precision by matching distance [m]."""
        return {distance_m: curve.average_precision for distance_m, curve in self.curves.items()}

    @property
    def mean_average_precision(self) -> float:
        """The mean of the average precisions over the matching distances."""
        return float(np.mean(list(self.average_precisions.values())))

    @property
    def errors(self) -> dict[ErrorName, float]:
        """The true positive errors: NaN if undefined for this class, 1 if there is no match."""
        curve, undefined = self.curves[ERROR_DISTANCE_M], UNDEFINED_ERRORS.get(self.name, ())
        return {name: float("nan") if name in undefined else curve.mean_error(name) for name in ERRORS}


@dataclass(frozen=True)
class EvaluationReport:
    """The metrics of all classes of the benchmark, in its order, including classes without ground truth.

    num_samples: samples whose boxes were evaluated. If only maps were evaluated, all metrics of boxes are NaN.
    map_iou: by map class; empty if there are no predicted maps or no ground-truth maps.
    ground_truth: numbers of ground-truth boxes: used, mapped to a class, and left out.
    derives_attributes: whether true attributes of any sample are unknown, and were derived from true speeds.
    num_map_samples: samples whose mask was evaluated, by map class.
    """

    num_samples: int
    classes: tuple[ClassReport, ...]
    map_iou: Mapping[str, float]
    ground_truth: BoxCounts
    derives_attributes: bool = False
    num_map_samples: Mapping[str, int] = field(default_factory=dict)

    @property
    def has_boxes(self) -> bool:
        """Whether boxes were evaluated. An evaluation of nothing has the worst scores of boxes."""
        return self.num_samples > 0 or not self.num_map_samples

    @property
    def mean_average_precision(self) -> float:
        """mAP: the mean over all classes. As in the benchmark, a class without ground truth counts as 0."""
        if not self.has_boxes:
            return float("nan")
        return float(np.mean([class_report.mean_average_precision for class_report in self.classes]))

    @property
    def mean_errors(self) -> dict[ErrorName, float]:
        """mATE, mASE, mAOE, mAVE and mAAE. Each is the mean over the classes for which it is defined."""
        if not self.has_boxes:
            return dict.fromkeys(ERRORS, float("nan"))
        return {
            name: float(np.nanmean([class_report.errors[name] for class_report in self.classes])) for name in ERRORS
        }

    @property
    def nds(self) -> float:
        """The nuScenes detection score: the weighted mean of mAP and of max(0, 1 - error) for the five mean errors."""
        if not self.has_boxes:
            return float("nan")
        scores = [max(0.0, 1.0 - error) for error in self.mean_errors.values()]
        return (MEAN_AP_WEIGHT * self.mean_average_precision + sum(scores)) / (MEAN_AP_WEIGHT + len(scores))

    def to_dict(self) -> dict[str, Any]:
        """The report as JSON values; NaN becomes None."""
        return {
            "samples": self.num_samples,
            "map_samples": dict(self.num_map_samples),
            **_finite({"mAP": self.mean_average_precision, "NDS": self.nds}),
            "errors": _finite(self.mean_errors),
            "map_iou": _finite(self.map_iou),
            "classes": {}
            if not self.has_boxes
            else {
                class_report.name: {
                    "truth": class_report.num_truth,
                    "detections": class_report.num_detections,
                    "AP": {f"{distance_m:g}": value for distance_m, value in class_report.average_precisions.items()},
                    "mean_AP": class_report.mean_average_precision,
                    "errors": _finite(class_report.errors),
                }
                for class_report in self.classes
            },
            "ground_truth": self.ground_truth.to_dict(),
            "true_attributes": "derived" if self.derives_attributes else "annotated",
        }


def _finite(values: Mapping[Any, float]) -> dict[str, float | None]:
    """The values with None for NaN and infinity."""
    return {str(name): value if np.isfinite(value) else None for name, value in values.items()}
