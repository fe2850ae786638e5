"""Anchors: K-means centroids of true boxes' centres in the ego frame, where object queries start."""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError
from .source import Source

DEFAULT_RANGE_M = (
    55.0  # Sparse4D's: farther objects are not detected, and would draw centroids away from those that are
)
NUM_STARTS = 3
MAX_ITERATIONS = 100
CONVERGED_M = 1e-3  # centroids that move less have settled

Array = NDArray[np.float64]
Labels = NDArray[np.int32]


class AnchorClusters(NamedTuple):
    """centroids (Q, 3) [m]; distance_m: from the points to their centroids, root mean square."""

    centroids: Array
    rms_distance_m: float


def ground_truth_centres(source: Source, indices: Iterable[int]) -> Iterator[Array]:
    """The centres (D, 3) [m] of the true boxes of each of these frames, in its own ego frame; unknown ones left out."""
    for index in indices:
        boxes = source.ground_truth_boxes(index)
        if boxes is not None:
            yield boxes[:, :3]


def centres_within_range(centres: list[Array], num_queries: int, range_m: float = DEFAULT_RANGE_M) -> Array:
    """The centres (D, 3) of all frames that lie within `range_m` of the ego. Raises InputError for too few places."""
    if not centres:
        raise InputError("truth: expected true boxes in the source; got none in any frame. Choose a source with truth.")
    known = np.concatenate(centres)
    near = known[np.linalg.norm(known, axis=1) <= range_m]
    num_places = len(np.unique(near, axis=0))
    if num_places < num_queries:
        frames = f"{len(centres)} frame" + ("" if len(centres) == 1 else "s")
        raise InputError(
            f"truth: expected at least {num_queries} true boxes within {range_m:g} m, one a query; got {num_places} of "
            f"{len(known)} in {frames}, each place counted once. Take a source of more frames, or fewer queries."
        )
    return near


def cluster_centres(points: Array, num_clusters: int, seed: int = 0) -> AnchorClusters:
    """K-means of points (D, 3) in plain metres, D at least `num_clusters`; the best of several starts by k-means++.

    Deterministic: the seed is that of OpenCV's generator, which belongs to the thread and is set here.
    """
    cv2.setRNGSeed(seed)
    single = points.astype(np.float32)[:, None]  # three channels: OpenCV takes a lone row for points of one dimension
    attempts = [_settle(single, num_clusters) for _ in range(NUM_STARTS)]
    _, labels = min(attempts, key=lambda attempt: attempt[0])
    centroids = _means(points, labels, num_clusters)
    squares = ((points - centroids[labels]) ** 2).sum(axis=1)
    return AnchorClusters(centroids, float(np.sqrt(squares.mean())))


def _settle(points: NDArray[np.float32], num_clusters: int) -> tuple[float, Labels]:
    """One start by k-means++, then iterations until no centroid moves. points: (D, 1, 3).

    Returns the sum of squared distances, and the labels (D,). One iteration a call: Python hears Ctrl-C only between
    the calls, and nobody waits for a hundred.
    """
    once = (cv2.TERM_CRITERIA_COUNT, 2, 0.0)  # OpenCV counts the centroids it starts from, so that two are one step
    start = np.empty((0, 1), np.int32)  # it finds its own
    compactness, labels, centroids = cv2.kmeans(points, num_clusters, start, once, 1, cv2.KMEANS_PP_CENTERS)
    for _ in range(MAX_ITERATIONS):
        before = centroids
        compactness, labels, centroids = cv2.kmeans(
            points, num_clusters, labels, once, 1, cv2.KMEANS_USE_INITIAL_LABELS
        )
        if np.linalg.norm(centroids - before, axis=1).max() <= CONVERGED_M:
            break
    return compactness, labels[:, 0].astype(np.int32)


def _means(points: Array, labels: Labels, num_clusters: int) -> Array:
    """The clusters' means (Q, 3) in double precision; OpenCV's are sums of float32."""
    sums = [np.bincount(labels, points[:, axis], num_clusters) for axis in range(3)]
    return np.stack(sums, axis=-1) / np.bincount(labels, minlength=num_clusters)[:, None]
