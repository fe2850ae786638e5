"""How far two answers are apart: one tensor against its reference, and one frame's boxes against theirs."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...runtime import Detections
from ...runtime.detections import select, sigmoid


@dataclass(frozen=True)
class TensorError:
    """absolute: the largest. relative: the largest over the reference's RMS, which is also the tolerance that would
    have passed. cosine: between the two as vectors. A NaN or an infinity on either side makes it infinite.
    frame: which frame it was.
    """

    absolute: float
    relative: float
    cosine: float
    frame: int = 0

    @classmethod
    def between(cls, actual: NDArray, expected: NDArray, frame: int = 0) -> "TensorError":
        """Compare two tensors of one shape."""
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
        """Compare boxes (Q, 9) number by number, each against its own RMS: metres would drown radians."""
        difference = box_difference(actual, expected)
        return cls.worst([cls.between(e + d, e, frame) for d, e in zip(difference.T, expected.T, strict=True)])

    @classmethod
    def worst(cls, errors: list["TensorError"]) -> "TensorError":
        """The one with the largest relative error."""
        return max(errors, key=lambda error: error.relative)


def box_difference(actual: NDArray, expected: NDArray) -> NDArray[np.float64]:
    """Differences (D, 9) of boxes, that of yaw the short way round."""
    difference = actual.astype(np.float64) - expected
    difference[:, 6] = (difference[:, 6] + np.pi) % (2 * np.pi) - np.pi
    return difference


@dataclass(frozen=True)
class FrameError:
    """One streamed frame against the reference.

    window: frames the reference looked at; boxes: found by the stream.
    box: the largest difference of a matched box in any of its nine numbers [m, rad, m/s]; score and map: the
    largest differences of probabilities; unmatched: boxes of either side without a partner; history: frames the
    stream looked at less those it should have.
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
        """`reference` holds class_logits, boxes and the map logits by name; `num_frames` is its window's size."""
        logits, boxes = reference["class_logits"], reference["boxes"]
        labels = np.array([classes.index(name) for name in detections.classes], dtype=np.int64)
        difference = np.abs(box_difference(detections.boxes, boxes[detections.queries]))
        scores = np.abs(detections.scores - sigmoid(logits)[detections.queries, labels])
        maps = [np.abs(mask - sigmoid(reference[name][0, 0])) for name, mask in detections.maps.items()]
        return cls(
            window=num_frames,
            boxes=len(detections),
            unmatched=_unmatched(detections, labels, logits, boxes, score_tolerance),
            box=_largest(difference),
            score=_largest(scores),
            map=_largest(np.array(maps)),
            history=detections.history.frames - num_frames,
        )


def _largest(values: NDArray) -> float:
    if not values.size:
        return 0.0
    return float(values.max()) if np.isfinite(values).all() else np.inf


def _unmatched(detections: Detections, labels: NDArray, logits: NDArray, boxes: NDArray, tolerance: float) -> int:
    """(query, class) pairs that only one side selected, beyond those that the cut at the last score explains."""
    queries, expected_labels, scores, _ = select(logits, boxes)
    found = set(zip(detections.queries.tolist(), labels.tolist(), strict=True))
    expected = set(zip(queries.tolist(), expected_labels.tolist(), strict=True))
    cut = float(scores[-1]) + tolerance if len(scores) else 0.0
    all_scores = sigmoid(logits)
    return sum(bool(all_scores[pair] > cut) for pair in found ^ expected)
