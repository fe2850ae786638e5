"""Detections: the decoder's outputs as a list of boxes, sorted by score."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .attributes import likely_attributes
from .frame import Frame

MAX_DETECTIONS = 500  # the nuScenes limit per sample


@dataclass(frozen=True)
class HistoryReport:
    """The history that a result is based on.

    frames: number of frames that the decoder used, the current one included; 0 for a skipped frame.
    reset_reason: why the history was reset before this frame, or None if it was continued.
    ages_s: age of each past frame that the decoder used [s], newest first.
    """

    frames: int
    reset_reason: str | None = None
    ages_s: tuple[float, ...] = ()


@dataclass(frozen=True)
class Detections:
    """The detected objects of one frame, sorted by score, highest first.

    boxes: (D, 9) float32 in the ego frame: x y z w l h [m], yaw [rad], vx vy [m/s] over ground. D is at most 500.
    scores: (D,) float32 in [0, 1].
    classes: the class names of the D boxes.
    queries: (D,) int64, the index of the object query that produced each box.
    attributes: the nuScenes attribute of each box, such as `vehicle.parked`, or "" for a class without attributes. If
        they are not given, they follow from class and speed, see `likely_attribute`.
    history: the number of frames used, and the reason of a reset.
    maps: (X, Y) float32 probabilities in [0, 1] by map class; `map[i, j]` is the cell at x_i (forward), y_j (left).
        Empty unless requested.
    dropped_queries: number of queries that were removed because one of their numbers was not finite.
    dropped_map_cells: number of map cells that were set to 0 because they were not finite.
    skipped: why the frame was skipped (lost cameras), or None if it was processed.
    timings_s: duration of each stage [s]: preprocess, projector, backbone, lifter, decoder, segmenter, postprocess.
    scene, token, timestamp_s: copied from the frame.
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
    attributes: tuple[str, ...] = None  # type: ignore[assignment]  # always set in the end

    def __post_init__(self) -> None:
        if self.attributes is None:
            attributes = likely_attributes(self.classes, self.boxes[:, 7:9])
            object.__setattr__(self, "attributes", attributes)  # the class is frozen

    @classmethod
    def of_skipped_frame(cls, frame: Frame, skipped: str) -> "Detections":
        """Return the empty result of a frame that was skipped for the reason `skipped`."""
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
        """Whether queries or map cells were dropped, because the network's outputs were not finite."""
        return self.dropped_queries > 0 or self.dropped_map_cells > 0


def select_detections(
    class_logits: NDArray[np.float32], boxes: NDArray[np.float32]
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32], int]:
    """Select the (query, class) pairs with the highest scores, over all queries and classes.

    class_logits: (Q, classes).
    boxes: (Q, 9). A query with any number that is not finite is dropped with all its classes.

    Returns the queries (D,), class indices (D,) and scores (D,), highest first, at most MAX_DETECTIONS; and the
    number of dropped queries. Pairs of equal score keep the order of queries and classes.
    """
    finite = np.logical_and.reduce(np.isfinite(np.concatenate((class_logits, boxes), axis=1)), axis=1)
    scores = sigmoid(np.where(finite[:, None], class_logits, -np.inf))
    queries, labels = np.unravel_index(_highest(scores.ravel()), scores.shape)
    kept = finite[queries]
    return queries[kept], labels[kept], scores[queries, labels][kept], int((~finite).sum())


def _highest(scores: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the indices of the MAX_DETECTIONS highest scores (D,), highest first. Equal scores keep their order."""
    candidates = np.arange(len(scores))
    if len(scores) > MAX_DETECTIONS:
        # A stable sort of all 9000 scores of `small` takes ten times as long. A partition alone has no order of ties,
        # so all scores that equal the last one are sorted too.
        lowest = np.partition(scores, -MAX_DETECTIONS)[-MAX_DETECTIONS]
        candidates = np.flatnonzero(scores >= lowest)
    return candidates[np.argsort(-scores[candidates], kind="stable")][:MAX_DETECTIONS]


def sigmoid(logits: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return 1 / (1 + exp(-x)) without overflow, elementwise."""
    # exp(-|x|) never overflows. For x < 0, numerator and denominator are multiplied by exp(x).
    exp_negative = np.exp(-np.abs(logits))
    return (np.where(logits >= 0, 1, exp_negative) / (1 + exp_negative)).astype(np.float32)
