"""The error of one streamed frame of a bundle against the reference."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..detections import Detections, select_detections, sigmoid
from .tensor_error import box_difference


@dataclass(frozen=True)
class FrameError:
    """The error of one streamed frame against the reference.

    window: number of frames in the reference's window.
    boxes: number of boxes that the stream returned.
    unmatched: number of boxes that only the stream or only the reference selected.
    box: largest difference in any of a box's nine numbers [m, rad, m/s], see `box_difference`.
    score: largest difference of a score.
    map: largest difference of a map probability.
    history: number of frames in the stream's window minus `window`.
    mean_position_m: mean distance between the centres of a box [m], weighted with the reference's scores.
    mean_score: sum of the differences of the scores, divided by the sum of the reference's scores.
    mean_map: mean difference of a map probability.

    The means are for quantized bundles, in which single boxes of low scores may differ.
    """

    window: int
    boxes: int
    unmatched: int
    box: float
    score: float
    map: float
    history: int
    mean_position_m: float = 0.0
    mean_score: float = 0.0
    mean_map: float = 0.0

    @classmethod
    def of_skipped_frame(cls, detections: Detections) -> "FrameError":
        """The error of a frame that must be skipped, because every camera is lost: any box is one too many."""
        boxes, frames = len(detections), detections.history.frames
        return cls(window=0, boxes=boxes, unmatched=boxes, box=0.0, score=0.0, map=0.0, history=frames)

    @classmethod
    def between(
        cls,
        detections: Detections,
        reference: Mapping[str, NDArray],
        classes: tuple[str, ...],
        num_frames: int,
        score_tolerance: float,
        heading: NDArray | None = None,
    ) -> "FrameError":
        """Compare the detections of one frame with the outputs of the reference.

        detections: the stream's result.
        reference: `class_logits` (Q, classes), `boxes` (Q, 9), and map logits (1, 1, X, Y) by map class.
        classes: class names, in the order of the logits.
        num_frames: number of frames in the reference's window.
        score_tolerance: allowed difference of scores. A box with a score so close to the lowest selected score may be
            selected by one side only.
        heading: the lengths (Q) of the reference's vectors (sin θ, cos θ), see `box_difference`.
        """
        logits, boxes = reference["class_logits"], reference["boxes"]
        # A name that the model does not have gets the label -1. Such a box is unmatched.
        labels = np.array([classes.index(name) if name in classes else -1 for name in detections.classes], np.int64)
        lengths = None if heading is None else heading[detections.queries]
        difference = np.abs(box_difference(detections.boxes, boxes[detections.queries], lengths))
        reference_scores = sigmoid(logits)[detections.queries, labels][labels >= 0]
        scores = np.abs(detections.scores[labels >= 0] - reference_scores)
        maps = [np.abs(mask - sigmoid(reference[name][0, 0])) for name, mask in detections.maps.items()]
        return cls(
            window=num_frames,
            boxes=len(detections),
            unmatched=_num_unmatched(detections, labels, logits, boxes, score_tolerance),
            box=_largest(difference),
            score=_largest(scores),
            map=_largest(np.array(maps)),
            history=detections.history.frames - num_frames,
            mean_position_m=_mean(np.linalg.norm(difference[labels >= 0, :3], axis=1), reference_scores),
            mean_score=_mean(scores / np.maximum(reference_scores, 1e-30), reference_scores),
            mean_map=_mean(np.array(maps), np.ones_like(maps)),
        )


def _largest(values: NDArray) -> float:
    """The largest value; 0 for no values, infinity if any value is not finite."""
    if not values.size:
        return 0.0
    return float(values.max()) if np.isfinite(values).all() else np.inf


def _mean(values: NDArray, weights: NDArray) -> float:
    """The weighted mean; 0 for no values, infinity if any value is not finite."""
    if not values.size:
        return 0.0
    return float(np.average(values, weights=weights)) if np.isfinite(values).all() else np.inf


def _num_unmatched(detections: Detections, labels: NDArray, logits: NDArray, boxes: NDArray, tolerance: float) -> int:
    """Number of (query, class) pairs that only one side selected.

    Pairs with a score near the lowest selected score do not count: rounding alone can move them across it.
    """
    queries, expected_labels, scores, _ = select_detections(logits, boxes)
    streamed = set(zip(detections.queries.tolist(), labels.tolist(), strict=True))
    expected = set(zip(queries.tolist(), expected_labels.tolist(), strict=True))
    limit = float(scores[-1]) + tolerance if len(scores) else 0.0
    all_scores = sigmoid(logits)
    return sum(pair[1] < 0 or bool(all_scores[pair] > limit) for pair in streamed ^ expected)
