"""Results: the decoder's numbers as a sorted list of boxes."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .frame import Frame

MAX_DETECTIONS = 500  # as many as nuScenes takes for a sample


@dataclass(frozen=True)
class HistoryReport:
    """frames: how many frames the decoder looked at, the current one included. reset_reason: why the history
    before this frame was dropped, or None. A frame that was left out was looked at by nobody: 0 frames.
    """

    frames: int
    reset_reason: str | None = None


@dataclass(frozen=True)
class Detections:
    """What was found in one frame, best first.

    boxes: (D, 9) float32 in the ego frame: x y z w l h [m], yaw [rad], vx vy [m/s] over ground.
    scores: (D,) float32 in [0, 1]. classes: D names. queries: (D,) the query each came from.
    maps: probabilities (X, Y) float32 by map class; empty unless asked for.
    dropped: how many queries gave numbers that are not finite and were left out; dropped_map_cells: how many cells of
        the maps did and are 0. The frame is `degraded` then.
    skipped: why the frame was left out, with lost cameras; None where it was looked at.
    """

    boxes: NDArray[np.float32]
    scores: NDArray[np.float32]
    classes: tuple[str, ...]
    queries: NDArray[np.int64]
    history: HistoryReport
    maps: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    dropped_queries: int = 0
    dropped_map_cells: int = 0
    skipped: str | None = None
    timings_s: Mapping[str, float] = field(default_factory=dict)
    scene: str = ""
    token: str = ""
    timestamp_s: float = 0.0

    @classmethod
    def of_skipped_frame(cls, frame: Frame, skipped: str) -> "Detections":
        """The answer to a frame that was left out."""
        return cls(
            boxes=np.zeros((0, 9), np.float32),
            scores=np.zeros(0, np.float32),
            classes=(),
            queries=np.zeros(0, np.int64),
            history=HistoryReport(0),
            skipped=skipped,
            scene=frame.scene,
            token=frame.token,
            timestamp_s=float(frame.timestamp_s),
        )

    def __len__(self) -> int:
        return len(self.scores)

    @property
    def degraded(self) -> bool:
        return self.dropped_queries > 0 or self.dropped_map_cells > 0


def select(
    class_logits: NDArray[np.float32], boxes: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32], int]:
    """The best (query, class) pairs over all queries and classes.

    class_logits (Q, classes), boxes (Q, 9). Returns queries (D,), class indices (D,), scores (D,), best first and
    at most MAX_DETECTIONS; and how many queries had a number that is not finite.
    """
    finite = np.logical_and.reduce(np.isfinite(np.concatenate((class_logits, boxes), axis=1)), axis=1)
    scores = sigmoid(np.where(finite[:, None], class_logits, -np.inf))
    order = np.argsort(-scores, axis=None, kind="stable")[:MAX_DETECTIONS]
    queries, labels = np.unravel_index(order, scores.shape)
    kept = finite[queries]
    return queries[kept], labels[kept], scores[queries, labels][kept], int((~finite).sum())


def sigmoid(logits: NDArray[np.float32]) -> NDArray[np.float32]:
    """1 / (1 + exp(-x)), without overflow."""
    half = np.exp(-np.abs(logits))
    return (np.where(logits >= 0, 1, half) / (1 + half)).astype(np.float32)
