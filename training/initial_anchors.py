"""Initial anchors: the positions of the queries at the start of a training run."""

import numpy as np
import torch
from torch import Tensor

from ..data.anchor_clustering import centres_within_range, cluster_centres
from .clips import Clips


def find_initial_anchors(clips: Clips, num_queries: int, seed: int) -> Tensor:
    """The K-means centroids of the centres of the ground-truth boxes.

    clips: the clips with the ground-truth boxes.
    num_queries: Q, the number of centroids.
    seed: the seed of K-means.

    Returns (Q, 3) float32 [m] in the ego frame. Raises InputError if the clips contain too few objects.
    """
    centres = centres_within_range(list(clips.ground_truth_centres()), num_queries)
    return torch.from_numpy(cluster_centres(centres, num_queries, seed).centroids.astype(np.float32))
