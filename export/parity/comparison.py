"""Errors of a bundle: of one tensor against its reference, and of one streamed frame against the reference."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...runtime import Detections
from ...runtime.detections import select_detections, sigmoid


@dataclass(frozen=True)
class TensorError:
    """The error of a tensor.

    absolute: largest absolute difference.
    relative: `absolute` over the RMS of the reference; the smallest tolerance that would have passed.
    cosine: cosine between the two tensors as vectors.
    frame: index of the frame.

    A NaN or an infinity on either side makes `absolute` and `relative` infinite.
    """

    absolute: float
    relative: float
    cosine: float
    frame: int = 0

    @classmethod
    def between(cls, actual: NDArray, expected: NDArray, frame: int = 0) -> "TensorError":
        """Compare two tensors. Different shapes count as an infinite error."""
        if actual.shape != expected.shape or not (np.isfinite(actual).all() and np.isfinite(expected).all()):
            return cls(np.inf, np.inf, -1.0, frame)
        a, e = actual.astype(np.float64).ravel(), expected.astype(np.float64).ravel()
        absolute = float(np.abs(a - e).max())
        rms = float(np.sqrt(np.mean(e**2)))
        norms = float(np.linalg.norm(a) * np.linalg.norm(e))
        cosine = float(a @ e) / norms if norms else float(absolute == 0)
        return cls(absolute, absolute / rms if rms else (0.0 if absolute == 0 else np.inf), cosine, frame)

    @classmethod
    def between_boxes(cls, actual: NDArray, expected: NDArray, frame: int = 0) -> "TensorError":
        """Compare boxes (Q, 9) column by column, each relative to its own RMS; returns the worst column.

        With one RMS for all, positions of 40 m would hide an error of 0.01 rad.
        """
        difference = box_difference(actual, expected)
        return cls.worst([cls.between(e + d, e, frame) for d, e in zip(difference.T, expected.T, strict=True)])

    @classmethod
    def worst(cls, errors: list["TensorError"]) -> "TensorError":
        """The error with the largest relative error."""
        return max(errors, key=lambda error: error.relative)


def box_difference(actual: NDArray, expected: NDArray) -> NDArray[np.float64]:
    """Differences (D, 9) of boxes, with the yaw difference in [-π, π)."""
    difference = actual.astype(np.float64) - expected
    difference[:, 6] = (difference[:, 6] + np.pi) % (2 * np.pi) - np.pi
    return difference


@dataclass(frozen=True)
class FrameError:
    """The error of one streamed frame against the reference.

    window: number of frames in the reference's window.
    boxes: number of boxes that the stream returned.
    unmatched: boxes that only the stream or only the reference selected.
    box: largest difference in any of a box's nine numbers [m, rad, m/s].
    score: largest difference of a score.
    map: largest difference of a map probability.
    history: number of frames in the stream's window minus `window`.
    """

    window: int
    boxes: int
    unmatched: int
    box: float
    score: float
    map: float
    history: int

    @classmethod
    def between(
        cls,
        detections: Detections,
        reference: Mapping[str, NDArray],
        classes: tuple[str, ...],
        num_frames: int,
        score_tolerance: float,
    ) -> "FrameError":
        """Compare the detections of one frame with the outputs of the reference.

        detections: the stream's result.
        reference: `class_logits` (Q, classes), `boxes` (Q, 9), and map logits (1, 1, X, Y) by map class.
        classes: class names, in the order of the logits.
        num_frames: number of frames in the reference's window.
        score_tolerance: allowed difference of scores. A selected box whose score is within it of the lowest selected
            score may be missing on the other side.
        """
        logits, boxes = reference["class_logits"], reference["boxes"]
        labels = np.array([classes.index(name) for name in detections.classes], dtype=np.int64)
        difference = np.abs(box_difference(detections.boxes, boxes[detections.queries]))
        scores = np.abs(detections.scores - sigmoid(logits)[detections.queries, labels])
        maps = [np.abs(mask - sigmoid(reference[name][0, 0])) for name, mask in detections.maps.items()]
        return cls(
            window=num_frames,
            boxes=len(detections),
            unmatched=_num_unmatched(detections, labels, logits, boxes, score_tolerance),
            box=_largest(difference),
            score=_largest(scores),
            map=_largest(np.array(maps)),
            history=detections.history.frames - num_frames,
        )


def _largest(values: NDArray) -> float:
    """The largest value; 0 for no values, infinity if any value is not finite."""
    if not values.size:
        return 0.0
    return float(values.max()) if np.isfinite(values).all() else np.inf


def _num_unmatched(detections: Detections, labels: NDArray, logits: NDArray, boxes: NDArray, tolerance: float) -> int:
    """Number of (query, class) pairs that only one side selected.

    Pairs with a score near the lowest selected score do not count: rounding alone can move them over the limit.
    """
    queries, expected_labels, scores, _ = select_detections(logits, boxes)
    streamed = set(zip(detections.queries.tolist(), labels.tolist(), strict=True))
    expected = set(zip(queries.tolist(), expected_labels.tolist(), strict=True))
    limit = float(scores[-1]) + tolerance if len(scores) else 0.0
    all_scores = sigmoid(logits)
    return sum(bool(all_scores[pair] > limit) for pair in streamed ^ expected)
