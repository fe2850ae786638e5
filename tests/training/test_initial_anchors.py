"""Tests of the initial anchors."""

import numpy as np

from duospacenet.runtime.frame import GroundTruth
from duospacenet.training.initial_anchors import find_initial_anchors, mean_box_size


def true_cars(centres):
    boxes = np.concatenate([centres, np.ones((len(centres), 6))], axis=1)
    return GroundTruth(boxes, ("car",) * len(boxes))


def test_initial_anchors_are_the_centroids_of_the_ground_truth_boxes():
    """Four distant positions in turn. Their boxes alternate between 0.1 m too high and 0.1 m too low."""
    positions = np.array([[10.0, 0, 1], [-10, 0, 1], [0, 20, 2], [0, -20, 0]])
    centres = [positions[[i % 4]] + [0, 0, 0.1 * (-1) ** (i // 4)] for i in range(144)]
    anchors = find_initial_anchors([true_cars(rows) for rows in centres], 4, 0).numpy()
    np.testing.assert_allclose(anchors[np.lexsort(anchors.T[::-1])], positions[[1, 3, 2, 0]], atol=1e-6)


def test_the_mean_size_is_that_of_all_boxes_within_range_of_the_models_classes():
    """A car and a pedestrian near the ego; a truck beyond 55 m, an empty box, and an animal are left out."""
    boxes = np.zeros((5, 9))
    boxes[:, 3:6] = [[2, 4, 1.5], [1, 1, 2.5], [3, 9, 4], [8, 8, 8], [1, 2, 1]]
    boxes[2, :2] = [40, 40]
    names = ("car", "pedestrian", "truck", "car", "animal")
    ground_truth = GroundTruth(boxes, names, num_points=np.array([5, 5, 5, 0, 5]))
    one_more = true_cars(np.array([[5.0, 0, 0]]))
    size = mean_box_size([ground_truth, one_more])
    np.testing.assert_allclose(size.numpy(), [(2 + 1 + 1) / 3, (4 + 1 + 1) / 3, (1.5 + 2.5 + 1) / 3])
