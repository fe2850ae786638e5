"""Initial anchors: the positions and the size of the queries at the start of a training run."""

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..data.anchor_clustering import DEFAULT_RANGE_M, centres_within_range, cluster_centres
from ..data.box_selection import select_boxes
from ..data.class_names import DETECTION_CLASSES
from ..runtime.frame import GroundTruth


def find_initial_anchors(
    ground_truths: Iterable[GroundTruth], num_queries: int, seed: int, classes: Sequence[str] = DETECTION_CLASSES
) -> Tensor:
    """The K-means centroids of the centres of the ground-truth boxes.

    ground_truths: the ground truth of each frame, from `Clips.ground_truth`.
    num_queries: Q, the number of centroids.
    seed: the seed of K-means.
    classes: the classes of the model. Boxes of other classes, and boxes without points, are left out.

    Returns (Q, 3) float32 [m] in the ego frame. Raises InputError if there are too few objects.
    """
    boxes = _observed_boxes(ground_truths, classes)
    centres = centres_within_range([frame[:, :3] for frame in boxes], num_queries)
    return torch.from_numpy(cluster_centres(centres, num_queries, seed).centroids.astype(np.float32))


def mean_box_size(ground_truths: Iterable[GroundTruth], classes: Sequence[str] = DETECTION_CLASSES) -> Tensor | None:
    """The mean width, length and height (3) [m] of the boxes that the anchors are clustered from, of all classes.

    Sparse4D's anchors have this size. Returns float64, or None if there is no such box.
    """
    boxes = np.concatenate([np.zeros((0, 9)), *_observed_boxes(ground_truths, classes)])
    near = boxes[np.linalg.norm(boxes[:, :3], axis=1) <= DEFAULT_RANGE_M]
    return torch.from_numpy(near[:, 3:6].mean(axis=0)) if len(near) else None


def _observed_boxes(ground_truths: Iterable[GroundTruth], classes: Sequence[str]) -> list[NDArray[np.float64]]:
    """The boxes (D, 9) of each frame that belong to the classes and are not known to hold no points."""
    return [select_boxes(ground_truth, classes).keep_observed().boxes for ground_truth in ground_truths]
