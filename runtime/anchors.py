"""Anchors: where object queries start, at K-means centroids of true boxes' centres in the ego frame; and their file."""

import math
import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator
from pydantic_core import PydanticCustomError

from .errors import ArtifactError, InputError, OutputError
from .files import discard, temporary_beside, write_atomically
from .records import Contract, Finite, Positive, PositiveFinite, matrix, read_json
from .sources import Source

SCHEMA_VERSION: Final = 1
RANGE_M = 55.0  # Sparse4D's: farther objects are not detected, and would draw centroids away from those that are
LARGEST_RANGE_M = 1000.0
ATTEMPTS = 3
MOST_ITERATIONS = 100
STILL_M = 1e-3  # centroids that move less have settled

Array = NDArray[np.float64]
Labels = NDArray[np.int32]
Centre = tuple[Finite, Finite, Finite]


class Anchors(Contract):
    """The file of anchors. centres_m: x, y, z of each in the ego frame.

    source: identity of the source; num_frames: those with true boxes; num_boxes: the boxes within range_m of the
    ego, whose centroids these are, and which lie within it as well; seed: of the clustering.
    """

    schema_version: Literal[1]
    source: str
    num_frames: Positive
    num_boxes: Positive
    range_m: Annotated[PositiveFinite, Field(le=LARGEST_RANGE_M)]
    seed: Annotated[int, Field(strict=True, ge=0)]
    centres_m: Annotated[tuple[Centre, ...], Field(min_length=1)]  # last: it is checked against range_m

    @field_validator("centres_m")
    @classmethod
    def _lie_within_range(cls, centres_m: tuple[Centre, ...], others: ValidationInfo) -> tuple[Centre, ...]:
        range_m = others.data.get("range_m", math.inf)  # where it is wrong itself, that is said
        for index, centre in enumerate(centres_m):
            if math.hypot(*centre) > range_m * (1 + 1e-6):
                raise PydanticCustomError(
                    "beyond_range",
                    f"expected each within range_m, {range_m:g} m, of the ego; index {index} is "
                    f"{math.hypot(*centre):g} m away",
                )
        return centres_m

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
        boxes = source.true_boxes(index)
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
        frames = f"{len(centres)} frame" + ("" if len(centres) == 1 else "s")
        raise InputError(
            f"truth: expected at least {num_queries} true boxes within {range_m:g} m, one a query; got {num_places} of "
            f"{len(known)} in {frames}, each place counted once. Take a source of more frames, or fewer queries."
        )
    return near


def cluster(points: Array, num_clusters: int, seed: int = 0) -> Clusters:
    """K-means of points (D, 3) in plain metres, D at least `num_clusters`; the best of several starts by k-means++.

    Deterministic: the seed is that of OpenCV's generator, which belongs to the thread and is set here.
    """
    cv2.setRNGSeed(seed)
    single = points.astype(np.float32)[:, None]  # three channels: OpenCV takes a lone row for points of one dimension
    attempts = [_settle(single, num_clusters) for _ in range(ATTEMPTS)]
    _, labels = min(attempts, key=lambda attempt: attempt[0])
    centroids = _means(points, labels, num_clusters)
    squares = ((points - centroids[labels]) ** 2).sum(axis=1)
    return Clusters(centroids, float(np.sqrt(squares.mean())))


def write_anchors(path: Path, anchors: Anchors) -> None:
    """Write anchors to a new file, whole or not at all. Raises OutputError where it cannot be written."""
    check_place(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror}") from error
    write_atomically(path, (anchors.model_dump_json() + "\n").encode())


def read_anchors(path: Path) -> Anchors:
    """Read a file of anchors. Raises ArtifactError, naming the file and the field."""
    return read_json(path, Anchors, ArtifactError)


def check_place(path: Path) -> None:
    """See that a new file can be written at `path`, in a folder that is there or can be made; nothing stays behind.

    Raises OutputError, also where a link stands at `path` that leads nowhere.
    """
    if os.path.lexists(path):
        got = "it is a folder. Name a file in it" if path.is_dir() else "it exists already. Remove it"
        raise OutputError(f"{path}: expected a new file; {got}, or choose another --out.")
    place = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    probe = temporary_beside(place / path.name)
    try:
        probe.touch()
    except OSError as error:
        raise OutputError(
            f"{path}: expected a place for a new file; {place} takes none ({error.strerror}). Choose another --out."
        ) from error
    finally:
        discard(probe)


def _settle(points: NDArray[np.float32], num_clusters: int) -> tuple[float, Labels]:
    """One start by k-means++, then iterations until no centroid moves. points: (D, 1, 3).

    Returns the sum of squared distances, and the labels (D,). One iteration a call: Python hears Ctrl-C only between
    the calls, and nobody waits for a hundred.
    """
    once = (cv2.TERM_CRITERIA_COUNT, 2, 0.0)  # OpenCV counts the centroids it starts from, so that two are one step
    start = np.empty((0, 1), np.int32)  # it finds its own
    compactness, labels, centroids = cv2.kmeans(points, num_clusters, start, once, 1, cv2.KMEANS_PP_CENTERS)
    for _ in range(MOST_ITERATIONS):
        before = centroids
        compactness, labels, centroids = cv2.kmeans(
            points, num_clusters, labels, once, 1, cv2.KMEANS_USE_INITIAL_LABELS
        )
        if np.linalg.norm(centroids - before, axis=1).max() <= STILL_M:
            break
    return compactness, labels[:, 0].astype(np.int32)


def _means(points: Array, labels: Labels, num_clusters: int) -> Array:
    """The clusters' means (Q, 3) in double precision; OpenCV's are sums of float32."""
    sums = [np.bincount(labels, points[:, axis], num_clusters) for axis in range(3)]
    return np.stack(sums, axis=-1) / np.bincount(labels, minlength=num_clusters)[:, None]
