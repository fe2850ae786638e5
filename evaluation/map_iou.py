"""Intersection over union of map masks, over all frames."""

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from .sample import Sample

THRESHOLD = 0.5  # of a probability: logit 0


class MapIou:
    """Counts cells class by class, frame after frame."""

    def __init__(self) -> None:
        self._intersection, self._union = Counter[str](), Counter[str]()

    def add(self, sample: Sample) -> None:
        """Count the maps that were drawn and are known. A frame that was skipped misses all of what is there."""
        found, skipped = sample.detections.maps, sample.detections.skipped is not None
        for name, true in sample.ground_truth.maps.items():
            if name in found:
                self._count(name, resample_mask(true, found[name].shape), found[name] > THRESHOLD)
            elif skipped:
                self._count(name, true, np.zeros_like(true))

    def iou(self) -> dict[str, float]:
        """By class; NaN where neither truth nor answers have a cell of it."""
        return {
            name: self._intersection[name] / union if union else float("nan") for name, union in self._union.items()
        }

    def _count(self, name: str, true: NDArray[np.bool_], found: NDArray[np.bool_]) -> None:
        self._intersection[name] += int((true & found).sum())
        self._union[name] += int((true | found).sum())


def resample_mask(mask: NDArray[np.bool_], shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """A mask (X, Y) on another grid over the same range: each cell is what lies at its centre."""
    rows, columns = (
        ((np.arange(size) + 0.5) * cells / size).astype(int) for size, cells in zip(shape, mask.shape, strict=True)
    )
    return mask[np.ix_(rows, columns)]
