"""The ground-truth boxes of one frame, with what is needed to compare them with those of other frames."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..data.class_names import UnknownClassError, find_class
from ..runtime.frame import Frame, GroundTruth

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LabelledFrame:
    """The ground truth of one frame.

    index: of the frame.
    frame: without images; its pose and time are valid.
    boxes: (D, 9) as in `GroundTruth.boxes`.
    classes: class of each box among the ten classes of nuScenes, or None for other objects.
    """

    index: int
    frame: Frame
    boxes: Array
    classes: tuple[str | None, ...]

    @classmethod
    def of(cls, index: int, frame: Frame, ground_truth: GroundTruth) -> "LabelledFrame":
        """Combine a frame with its ground truth."""
        classes = tuple(_class_or_none(name, ground_truth) for name in ground_truth.classes)
        return cls(index, frame, ground_truth.boxes, classes)


def ranges_m(boxes: Array) -> Array:
    """The distances (D,) [m] of boxes (D, 9) from the ego origin, in the ground plane."""
    return np.asarray(np.hypot(boxes[:, 0], boxes[:, 1]), np.float64)


def _class_or_none(name: str, ground_truth: GroundTruth) -> str | None:
    try:
        return find_class(name, class_mapping=ground_truth.class_mapping)
    except UnknownClassError:
        return None
