"""From samples to a report, by the rules of nuScenes' detection benchmark."""

from collections import Counter
from collections.abc import Iterable

import numpy as np

from .boxes import Boxes
from .evaluation_report import ClassReport, Report
from .greedy_matching import UNMATCHED, match_detections
from .map_iou import MapOverlap
from .precision_curve import Curve
from .protocol import CLASSES, DISTANCES_M, heading_period_rad
from .sample import Sample
from .true_positive_errors import true_positive_errors


def evaluate(samples: Iterable[Sample]) -> Report:
    """Judge samples, one at a time as they come; only their boxes are kept until the last.

    Each class is matched over all samples in descending score. Of the truth, boxes that no sensor sees should have
    been left out (nuScenes leaves out those without a point). Raises InputError for a sample that the benchmark does
    not take.
    """
    ground_truth, found, overlap, ignored = [], [], MapOverlap(), Counter[str]()
    for number, sample in enumerate(samples):
        sample.check(number)
        true, detections = sample.ground_truth, sample.detections
        ground_truth.append(
            Boxes.of(number, true.boxes, np.zeros(len(true.boxes)), true.classes, sample.true_attributes)
        )
        found.append(Boxes.of(number, detections.boxes, detections.scores, detections.classes))
        overlap.add(sample)
        ignored.update(name for name in true.classes if name not in CLASSES)
    all_truth, all_found = Boxes.concatenated(ground_truth), Boxes.concatenated(found)
    classes = tuple(
        evaluate_class(name, all_truth[all_truth.label == label], all_found[all_found.label == label])
        for label, name in enumerate(CLASSES)
    )
    return Report(len(ground_truth), classes, overlap.iou(), ignored)


def evaluate_class(name: str, ground_truth: Boxes, found: Boxes) -> ClassReport:
    """All numbers of one class, whose boxes these are."""
    matches = match_detections(ground_truth, found, DISTANCES_M)
    ranked = found[matches.ranked]
    score = ranked.score.astype(np.float64)
    curves = {}
    for distance_m, matched in zip(DISTANCES_M, matches.ground_truth, strict=True):
        hit = matched != UNMATCHED
        errors = true_positive_errors(ground_truth[matched[hit]], ranked[hit], heading_period_rad(name))
        curves[distance_m] = Curve.of(score, hit, errors, len(ground_truth))
    return ClassReport(name, len(ground_truth), len(found), curves)
