"""Evaluates samples by the rules of the nuScenes detection benchmark."""

from collections.abc import Iterable, Sequence

import numpy as np

from ..data.box_counts import BoxCounts
from ..data.box_selection import BoxSelection
from .box_filter import bicycle_racks, is_in_rack, select_true_boxes
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

    The detections of each class are ranked by score over all samples. Boxes are left out by the rules of the
    benchmark, see `box_filter`. Boxes are only evaluated in samples whose true boxes are known, and each map class
    only in samples with its true mask.

    Raises InputError for a sample that the benchmark does not accept, or with class names that are not known.
    """
    truth_parts, detection_parts, map_iou, counts = [], [], MapIou(), BoxCounts()
    num_samples, derives_attributes = 0, False
    for number, sample in enumerate(samples):
        sample.check(number)
        map_iou.add(sample)
        if not sample.ground_truth.has_boxes:
            continue
        selection = select_true_boxes(sample.ground_truth, f"sample {number}: ground truth", sample.ego_m)
        truth_parts.append(_true_boxes(number, sample, selection))
        detection_parts.append(_detected_boxes(number, sample))
        counts += selection.counts
        num_samples += 1
        derives_attributes |= sample.ground_truth.attributes is None
    all_truth, all_detections = EvalBoxes.concatenate(truth_parts), EvalBoxes.concatenate(detection_parts)
    classes = tuple(
        evaluate_class(name, all_truth[all_truth.label == label], all_detections[all_detections.label == label])
        for label, name in enumerate(CLASSES)
    )
    return EvaluationReport(
        num_samples, classes, map_iou.by_class(), counts, derives_attributes, dict(map_iou.num_frames)
    )


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


def _true_boxes(number: int, sample: Sample, selection: BoxSelection) -> EvalBoxes:
    attributes: Sequence[str] | None = sample.ground_truth.attributes
    if attributes is not None:
        attributes = [attributes[row] for row in selection.rows]
    scores = np.zeros(len(selection.rows))
    return EvalBoxes.of_sample(number, selection.boxes, scores, selection.classes, attributes, sample.ego_m)


def _detected_boxes(number: int, sample: Sample) -> EvalBoxes:
    """The detections that are not in a bicycle rack."""
    detections = sample.detections
    kept = ~is_in_rack(detections.boxes, detections.classes, bicycle_racks(sample.ground_truth))
    classes, attributes = (
        [name for name, is_kept in zip(names, kept, strict=True) if is_kept]
        for names in (detections.classes, detections.attributes)
    )
    boxes, scores = detections.boxes[kept], detections.scores[kept]
    return EvalBoxes.of_sample(number, boxes, scores, classes, attributes, sample.ego_m)
