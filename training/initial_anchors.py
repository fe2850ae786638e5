"""Initial anchors: the positions of the queries at the start of a training run."""

from collections.abc import Iterable, Sequence

import numpy as np
import torch
from torch import Tensor

from ..data.anchor_clustering import centres_within_range, cluster_centres
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
    selections = (select_boxes(ground_truth, classes).keep_observed() for ground_truth in ground_truths)
    centres = centres_within_range([selection.boxes[:, :3] for selection in selections], num_queries)
    return torch.from_numpy(cluster_centres(centres, num_queries, seed).centroids.astype(np.float32))
