"""Where the queries start: K-means centroids of the true boxes (paper, "Implementation Details")."""

import numpy as np
import torch
from torch import Tensor

from ..runtime.anchors import cluster, within_range
from .drives import Drives


def find_anchors(drives: Drives, num_queries: int, seed: int) -> Tensor:
    """Centres (Q, 3) [m] in the ego frame. Raises InputError where the drives hold too few objects."""
    centres = list(drives.true_centres())
    return torch.from_numpy(cluster(within_range(centres, num_queries), num_queries, seed).centroids.astype(np.float32))
