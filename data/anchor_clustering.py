"""Anchor clustering: K-means of ground-truth box centres in the ego frame. Object queries start at the centroids."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError

# As in Sparse4D. Farther objects are not detected. Their boxes would pull centroids away from objects that are.
DEFAULT_RANGE_M = 55.0
NUM_STARTS = 3
MAX_ITERATIONS = 100
CONVERGED_M = 1e-3  # iterations end when no centroid moves farther than this

Array = NDArray[np.float64]
Labels = NDArray[np.int32]


class AnchorClusters(NamedTuple):
    """The result of a clustering.

    centroids: (Q, 3) [m].
    rms_distance_m: root mean square of the distances from the points to their centroids.
    """

    centroids: Array
    rms_distance_m: float


def centres_within_range(centres: list[Array], num_queries: int, range_m: float = DEFAULT_RANGE_M) -> Array:
    """Return the centres (D, 3) [m] that are at most `range_m` from the ego, of all frames together.

    centres: (D, 3) [m] of each frame, in its ego frame.
    num_queries: number of anchors; each needs a different centre.

    Raises InputError if there are fewer different centres than queries, or if the boxes of all frames are unknown.
    """
    if not centres:
        raise InputError(
            "ground truth: expected boxes in the source; got no frame with known boxes. "
            "Choose a source with ground truth."
        )
    known = np.concatenate(centres)
    near = known[np.linalg.norm(known, axis=1) <= range_m]
    num_places = len(np.unique(near, axis=0))  # parked cars seen from a parked ego give the same centre every frame
    if num_places < num_queries:
        frames = f"{len(centres)} frame" + ("" if len(centres) == 1 else "s")
        raise InputError(
            f"ground truth: expected at least {num_queries} different box centres within {range_m:g} m, one per query; "
            f"got {num_places} among {len(known)} boxes in {frames}. Choose a source of more frames, or fewer queries."
        )
    return near


def cluster_centres(points: Array, num_clusters: int, seed: int = 0) -> AnchorClusters:
    """Cluster points (D, 3) [m] by K-means, without scaling the axes; D is at least `num_clusters`.

    The best of several k-means++ starts is kept. The result depends on the points and the seed only.
    """
    cv2.setRNGSeed(seed)  # sets OpenCV's generator of this thread
    # Three channels, because OpenCV would read a single row (1, 3) as three points of one dimension.
    channels = points.astype(np.float32)[:, None]
    attempts = [_run_kmeans(channels, num_clusters) for _ in range(NUM_STARTS)]
    _, labels = min(attempts, key=lambda attempt: attempt[0])
    centroids = _means(points, labels, num_clusters)
    squares = ((points - centroids[labels]) ** 2).sum(axis=1)
    return AnchorClusters(centroids, float(np.sqrt(squares.mean())))


def _run_kmeans(points: NDArray[np.float32], num_clusters: int) -> tuple[float, Labels]:
    """Run K-means once: a k-means++ start, then iterations until it converges. points: (D, 1, 3).

    Returns the sum of squared distances, and the labels (D,).
    """
    # One iteration per call, because Python handles Ctrl-C only between calls. OpenCV counts the start as an
    # iteration, so a limit of two means one step.
    one_step = (cv2.TERM_CRITERIA_COUNT, 2, 0.0)
    no_labels = np.empty((0, 1), np.int32)
    compactness, labels, centroids = cv2.kmeans(points, num_clusters, no_labels, one_step, 1, cv2.KMEANS_PP_CENTERS)
    for _ in range(MAX_ITERATIONS):
        before = centroids
        compactness, labels, centroids = cv2.kmeans(
            points, num_clusters, labels, one_step, 1, cv2.KMEANS_USE_INITIAL_LABELS
        )
        if np.linalg.norm(centroids - before, axis=1).max() <= CONVERGED_M:
            break
    return compactness, labels[:, 0].astype(np.int32)


def _means(points: Array, labels: Labels, num_clusters: int) -> Array:
    """Return the clusters' means (Q, 3) in float64; OpenCV computes them in float32."""
    sums = [np.bincount(labels, points[:, axis], num_clusters) for axis in range(3)]
    return np.stack(sums, axis=-1) / np.bincount(labels, minlength=num_clusters)[:, None]
