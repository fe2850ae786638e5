"""Intersection over union (IoU) of map masks, accumulated over all frames."""

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from ..data.mask_resampling import resample_mask
from .sample import Sample

THRESHOLD = 0.5  # a cell with a larger probability belongs to the map class; equals a logit of 0


class MapIou:
    """Counts intersection and union cells of each map class."""

    def __init__(self) -> None:
        self._intersection, self._union = Counter[str](), Counter[str]()
        self.num_frames = Counter[str]()  # frames that were counted, by map class

    def add(self, sample: Sample) -> None:
        """Count the cells of the maps that have a prediction and ground truth. A skipped frame predicts empty maps."""
        predictions, is_skipped = sample.detections.maps, sample.detections.skipped is not None
        for name, truth in sample.ground_truth.maps.items():
            if name in predictions:
                predicted = predictions[name] > THRESHOLD
                self._count(name, resample_mask(truth, predicted.shape), predicted)
            elif is_skipped:
                self._count(name, truth, np.zeros_like(truth))

    def by_class(self) -> dict[str, float]:
        """IoU by map class; NaN if neither ground truth nor predictions have a cell of the class."""
        return {
            name: self._intersection[name] / union if union else float("nan") for name, union in self._union.items()
        }

    def _count(self, name: str, truth: NDArray[np.bool_], predicted: NDArray[np.bool_]) -> None:
        self.num_frames[name] += 1
        self._intersection[name] += int((truth & predicted).sum())
        self._union[name] += int((truth | predicted).sum())
