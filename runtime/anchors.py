"""Anchors: where object queries start, at K-means centroids of true boxes' centres in the ego frame; and their file."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from .errors import ArtifactError, InputError, OutputError
from .files import write_atomically
from .records import Contract, Finite, Positive, PositiveFinite, matrix, read_json
from .sources import Source
from .sources.scene_folder import SceneFolder

SCHEMA_VERSION: Final = 1
RANGE_M = 55.0  # Sparse4D's: farther objects are not detected, and would draw centroids away from those that are
ATTEMPTS = 3
MOST_ITERATIONS = 100
STILL_M = 1e-3  # centroids that move less have settled

Array = NDArray[np.float64]
Centre = tuple[Finite, Finite, Finite]


class Anchors(Contract):
    """The file of anchors. centres_m: x, y, z of each in the ego frame.

    source: identity of the source; num_frames: those with true boxes; num_boxes: the boxes within range_m of the
    ego, whose centroids these are; seed: of the clustering.
    """

    schema_version: Literal[1]
    centres_m: Annotated[tuple[Centre, ...], Field(min_length=1)]
    source: str
    num_frames: Positive
    num_boxes: Positive
    range_m: PositiveFinite
    seed: Annotated[int, Field(strict=True, ge=0)]

    @property
    def centres(self) -> Array:
        """(Q, 3) [m]."""
        return matrix(self.centres_m)


class Clusters(NamedTuple):
    """centroids (Q, 3) [m]; distance_m: from the points to their centroids, root mean square."""

    centroids: Array
    distance_m: float


def true_centres(source: Source, indices: Iterable[int]) -> Iterator[Array]:
    """The centres (D, 3) [m] of the true boxes of each of these frames, in its own ego frame; unknown ones left out."""
    for index in indices:
        boxes = _true_boxes(source, index)
        if boxes is not None:
            yield boxes[:, :3]


def within_range(centres: list[Array], num_queries: int, range_m: float = RANGE_M) -> Array:
    """The centres (D, 3) of all frames that lie within `range_m` of the ego. Raises InputError for too few places."""
    if not centres:
        raise InputError("truth: expected true boxes in the source; got none in any frame. Choose a source with truth.")
    known = np.concatenate(centres)
    near = known[np.linalg.norm(known, axis=1) <= range_m]
    num_places = len(np.unique(near, axis=0))
    if num_places < num_queries:
        raise InputError(
            f"truth: expected at least {num_queries} true boxes within {range_m:g} m, one a query; got {num_places} of "
            f"{len(known)} in {len(centres)} frames, each place counted once. Take a source of more frames, or fewer "
            "--queries."
        )
    return near


def cluster(points: Array, num_clusters: int, seed: int = 0) -> Clusters:
    """K-means of points (D, 3) in plain metres, D at least `num_clusters`; the best of several starts by k-means++.

    Deterministic: the seed is that of OpenCV's generator, which belongs to the thread and is set here.
    """
    cv2.setRNGSeed(seed)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, MOST_ITERATIONS, STILL_M)
    start = np.empty((0, 1), np.int32)  # OpenCV finds its own
    single = points.astype(np.float32)
    _, labels, _ = cv2.kmeans(single, num_clusters, start, criteria, ATTEMPTS, cv2.KMEANS_PP_CENTERS)
    nearest = labels[:, 0].astype(np.int32)
    centroids = _means(points, nearest, num_clusters)
    squares = ((points - centroids[nearest]) ** 2).sum(axis=1)
    return Clusters(centroids, float(np.sqrt(squares.mean())))


def write_anchors(path: Path, anchors: Anchors) -> None:
    """Write anchors to a new file, whole or not at all. Raises OutputError where it cannot be written."""
    check_free(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error
    write_atomically(path, (anchors.model_dump_json() + "\n").encode())


def read_anchors(path: Path) -> Anchors:
    """Read a file of anchors. Raises ArtifactError, naming the file and the field."""
    return read_json(path, Anchors, ArtifactError)


def check_free(path: Path) -> None:
    """Raises OutputError when something stands at `path`."""
    if path.exists():
        raise OutputError(f"{path}: expected a new file; it exists already. Remove it, or choose another --out.")


def _true_boxes(source: Source, index: int) -> Array | None:
    if isinstance(source, SceneFolder):
        return source.true_boxes(index)  # without its images, which are most of the work
    truth = source.frame(index).truth
    return None if truth is None else truth.boxes


def _means(points: Array, labels: NDArray[np.int32], num_clusters: int) -> Array:
    """The clusters' means (Q, 3) in double precision; OpenCV's are sums of float32."""
    sums = [np.bincount(labels, points[:, axis], num_clusters) for axis in range(3)]
    return np.stack(sums, axis=-1) / np.bincount(labels, minlength=num_clusters)[:, None]
