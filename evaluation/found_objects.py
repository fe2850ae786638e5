"""Which true objects of one frame a result contains, by the matching rule of the benchmark."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .boxes import NO_ATTRIBUTE, EvalBoxes
from .greedy_matching import match_detections
from .protocol import ERROR_DISTANCE_M

_ONE_CLASS = 0  # boxes are matched class by class, so the label does not matter


def find_objects(
    true_boxes: NDArray[np.floating],
    true_classes: Sequence[str],
    boxes: NDArray[np.floating],
    scores: NDArray[np.floating],
    classes: Sequence[str],
) -> NDArray[np.bool_]:
    """Return (G,) whether each true box has a detection of its class within 2 m in x and y.

    true_boxes: (G, 9), and their classes. boxes: (D, 9), their scores (D,) and classes; all in the ego frame.
    A detection is matched with the nearest true box that is free, the highest score first.
    """
    found = np.zeros(len(true_boxes), np.bool_)
    for name in set(true_classes):
        rows = np.flatnonzero([each == name for each in true_classes])
        detected = np.flatnonzero([each == name for each in classes])
        truth = _of_one_class(true_boxes[rows], np.zeros(len(rows)))
        matches = match_detections(truth, _of_one_class(boxes[detected], scores[detected]), [ERROR_DISTANCE_M])
        matched = matches.ground_truth[0]
        found[rows[matched[matched >= 0]]] = True
    return found


def _of_one_class(boxes: NDArray[np.floating], scores: NDArray[np.floating]) -> EvalBoxes:
    sample, label = np.zeros(len(boxes), np.int32), np.full(len(boxes), _ONE_CLASS, np.int8)
    return EvalBoxes(sample, label, boxes, scores, np.full(len(boxes), NO_ATTRIBUTE, np.int8))
