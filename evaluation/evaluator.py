"""Evaluates samples by the rules of the nuScenes detection benchmark."""

from collections import Counter
from collections.abc import Iterable

import numpy as np

from .boxes import EvalBoxes
from .evaluation_report import ClassReport, EvaluationReport
from .greedy_matching import UNMATCHED, match_detections
from .map_iou import MapIou
from .precision_curve import PrecisionCurve
from .protocol import CLASSES, MATCHING_DISTANCES_M, heading_period_rad
from .sample import Sample
from .true_positive_errors import true_positive_errors


def evaluate(samples: Iterable[Sample]) -> EvaluationReport:
    """Evaluate samples. They are read one at a time, and only their boxes are kept in memory.

    The detections of each class are ranked by score over all samples. The ground truth should contain only objects that
    a sensor has observed; nuScenes removes boxes without lidar or radar points.

    Raises InputError for a sample that the benchmark does not accept.
    """
    truth_parts, detection_parts, map_iou, ignored = [], [], MapIou(), Counter[str]()
    for number, sample in enumerate(samples):
        sample.check(number)
        truth, detections = sample.ground_truth, sample.detections
        truth_parts.append(
            EvalBoxes.of_sample(number, truth.boxes, np.zeros(len(truth.boxes)), truth.classes, sample.true_attributes)
        )
        detection_parts.append(EvalBoxes.of_sample(number, detections.boxes, detections.scores, detections.classes))
        map_iou.add(sample)
        ignored.update(name for name in truth.classes if name not in CLASSES)
    all_truth, all_detections = EvalBoxes.concatenate(truth_parts), EvalBoxes.concatenate(detection_parts)
    classes = tuple(
        evaluate_class(name, all_truth[all_truth.label == label], all_detections[all_detections.label == label])
        for label, name in enumerate(CLASSES)
    )
    return EvaluationReport(len(truth_parts), classes, map_iou.by_class(), ignored)


def evaluate_class(name: str, ground_truth: EvalBoxes, detections: EvalBoxes) -> ClassReport:
    """Evaluate one class.

    ground_truth, detections: the boxes of this class in all samples.
    """
    matches = match_detections(ground_truth, detections, MATCHING_DISTANCES_M)
    ranked = detections[matches.ranked]
    score = ranked.score.astype(np.float64)
    curves = {}
    for distance_m, matched in zip(MATCHING_DISTANCES_M, matches.ground_truth, strict=True):
        is_match = matched != UNMATCHED
        errors = true_positive_errors(ground_truth[matched[is_match]], ranked[is_match], heading_period_rad(name))
        curves[distance_m] = PrecisionCurve.from_matches(score, is_match, errors, len(ground_truth))
    return ClassReport(name, len(ground_truth), len(detections), curves)
