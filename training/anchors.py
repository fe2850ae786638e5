"""Where the queries start: K-means centroids of the objects of the first frames (paper, "Implementation Details")."""

from itertools import chain, count, islice

import numpy as np
import torch
from torch import Tensor

from ..runtime.anchors import cluster, within_range
from .drives import Drives
from .samples import truth_of

NUM_FRAMES = 144


def find_anchors(drives: Drives, num_queries: int, seed: int) -> Tensor:
    """Centres (Q, 3) [m] in the ego frame. Raises InputError where the drives hold too few objects,
    or a frame no truth."""
    frames = islice(chain.from_iterable(map(drives.frames, count())), NUM_FRAMES)
    centres = [truth_of(frame).boxes[:, :3] for frame in frames]
    return torch.from_numpy(cluster(within_range(centres, num_queries), num_queries, seed).centroids.astype(np.float32))
