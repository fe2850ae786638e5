"""From samples to a report, by the rules of nuScenes' detection benchmark."""

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
    """Judge samples, one at a time as they come; only their boxes are kept until the last.

    Each class is matched over all samples in descending score. Of the truth, boxes that no sensor sees should have
    been left out (nuScenes leaves out those without a point). Raises InputError for a sample that the benchmark does
    not take.
    """
    ground_truth, found, overlap, ignored = [], [], MapIou(), Counter[str]()
    for number, sample in enumerate(samples):
        sample.check(number)
        true, detections = sample.ground_truth, sample.detections
        ground_truth.append(
            EvalBoxes.of(number, true.boxes, np.zeros(len(true.boxes)), true.classes, sample.true_attributes)
        )
        found.append(EvalBoxes.of(number, detections.boxes, detections.scores, detections.classes))
        overlap.add(sample)
        ignored.update(name for name in true.classes if name not in CLASSES)
    all_truth, all_found = EvalBoxes.concatenated(ground_truth), EvalBoxes.concatenated(found)
    classes = tuple(
        evaluate_class(name, all_truth[all_truth.label == label], all_found[all_found.label == label])
        for label, name in enumerate(CLASSES)
    )
    return EvaluationReport(len(ground_truth), classes, overlap.iou(), ignored)


def evaluate_class(name: str, ground_truth: EvalBoxes, found: EvalBoxes) -> ClassReport:
    """All numbers of one class, whose boxes these are."""
    matches = match_detections(ground_truth, found, MATCHING_DISTANCES_M)
    ranked = found[matches.ranked]
    score = ranked.score.astype(np.float64)
    curves = {}
    for distance_m, matched in zip(MATCHING_DISTANCES_M, matches.ground_truth, strict=True):
        hit = matched != UNMATCHED
        errors = true_positive_errors(ground_truth[matched[hit]], ranked[hit], heading_period_rad(name))
        curves[distance_m] = PrecisionCurve.of(score, hit, errors, len(ground_truth))
    return ClassReport(name, len(ground_truth), len(found), curves)
