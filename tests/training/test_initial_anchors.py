"""Tests of the initial anchors."""

import numpy as np

from duospacenet.runtime.frame import GroundTruth
from duospacenet.training.initial_anchors import find_initial_anchors


def true_cars(centres):
    boxes = np.concatenate([centres, np.ones((len(centres), 6))], axis=1)
    return GroundTruth(boxes, ("car",) * len(boxes))


def test_initial_anchors_are_the_centroids_of_the_ground_truth_boxes():
    """Four distant positions in turn. Their boxes alternate between 0.1 m too high and 0.1 m too low."""
    positions = np.array([[10.0, 0, 1], [-10, 0, 1], [0, 20, 2], [0, -20, 0]])
    centres = [positions[[i % 4]] + [0, 0, 0.1 * (-1) ** (i // 4)] for i in range(144)]
    anchors = find_initial_anchors([true_cars(rows) for rows in centres], 4, 0).numpy()
    np.testing.assert_allclose(anchors[np.lexsort(anchors.T[::-1])], positions[[1, 3, 2, 0]], atol=1e-6)
