"""The agreement of two detectors on the same frames, without ground truth."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.detections import Detections

MIN_SCORE = 0.1  # detections of the reference with a lower score are not compared
MATCHING_DISTANCE_M = 1.0


@dataclass
class Agreement:
    """Compares detections with those of a reference, frame by frame.

    Each detection of the reference with a score of at least `MIN_SCORE` is matched with the nearest detection of the
    same class that is not matched yet, if their centres are at most `MATCHING_DISTANCE_M` apart in x and y. The
    detections with the highest scores are matched first.

    boxes: compared detections of the reference. matched: those with a match.
    """

    boxes: int = 0
    matched: int = 0
    _score: float = 0.0
    _distance_m: float = 0.0

    def add(self, reference: Detections, detections: Detections) -> None:
        """Compare the detections of one frame."""
        free = np.ones(len(detections), dtype=bool)
        for index in range(len(reference)):  # they are in descending order of score
            if reference.scores[index] < MIN_SCORE:
                break
            self.boxes += 1
            distances_m = np.where(free, _distances_m(reference, index, detections), np.inf)
            nearest = int(np.argmin(distances_m)) if len(detections) else None
            if nearest is None or not distances_m[nearest] <= MATCHING_DISTANCE_M:
                continue
            free[nearest] = False
            self.matched += 1
            self._score += abs(float(reference.scores[index]) - float(detections.scores[nearest]))
            self._distance_m += float(distances_m[nearest])

    @property
    def matched_fraction(self) -> float:
        """The fraction of the detections that are matched. It is 1 without detections."""
        return self.matched / self.boxes if self.boxes else 1.0

    @property
    def mean_score_difference(self) -> float:
        """The mean absolute difference of the scores of matched detections. It is 0 without matches."""
        return self._score / self.matched if self.matched else 0.0

    @property
    def mean_distance_m(self) -> float:
        """The mean distance of the centres of matched detections [m]. It is 0 without matches."""
        return self._distance_m / self.matched if self.matched else 0.0


def _distances_m(reference: Detections, index: int, detections: Detections) -> NDArray[np.float64]:
    """The distances [m] of all detections from box `index` of the reference; infinite for other classes."""
    offsets = detections.boxes[:, :2].astype(np.float64) - reference.boxes[index, :2]
    same_class = np.array([name == reference.classes[index] for name in detections.classes], dtype=bool)
    return np.where(same_class, np.linalg.norm(offsets, axis=1), np.inf)
