"""Clipping many polygons at planes, in one vectorised pass per plane."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .polygons import Counts, first_points

Array = NDArray[np.float64]


class ClippedPolygons(NamedTuple):
    """F' polygons after clipping.

    points: (V', 3). Points of polygons that were removed may be among them.
    starts, counts: (F',) the first point and the number of points of each polygon.
    sources: (F',) index of the polygon before clipping, ascending.
    """

    points: Array
    starts: Counts
    counts: Counts
    sources: Counts


def clip_polygons(points: Array, counts: Counts, planes: Array) -> ClippedPolygons:
    """Clip polygons to the inside of all planes; see `clip_at_plane`.

    points: (V, 3), of all polygons one after the other.
    counts: (F,) number of points of each polygon.
    planes: (n, 4).
    """
    starts = first_points(counts)
    inside = planes[:, :3] @ points.T + planes[:, 3:] >= 0
    # Most polygons are entirely inside or outside; only the others are clipped.
    is_whole = np.logical_and.reduceat(np.logical_and.reduce(inside), starts)
    is_crossing = np.logical_and.reduce(np.logical_or.reduceat(inside, starts, axis=1)) & ~is_whole
    pieces, piece_counts = points[np.repeat(is_crossing, counts)], counts[is_crossing]
    for plane in planes:
        pieces, piece_counts = clip_at_plane(pieces, piece_counts, plane)
    remains = piece_counts > 0
    whole, crossing = np.flatnonzero(is_whole), np.flatnonzero(is_crossing)[remains]
    sources = np.concatenate([whole, crossing])
    order = np.argsort(sources, kind="stable")
    return ClippedPolygons(
        np.concatenate([points, pieces]),
        np.concatenate([starts[whole], len(points) + first_points(piece_counts)[remains]])[order],
        np.concatenate([counts[whole], piece_counts[remains]])[order],
        sources[order],
    )


def clip_at_plane(points: Array, counts: Counts, plane: Array) -> tuple[Array, Counts]:
    """Clip polygons to the side of a plane where `plane[:3] @ point + plane[3] >= 0` (Sutherland and Hodgman, 1974).

    points: (V, 3), of all polygons one after the other.
    counts: (F,) number of points of each polygon.
    plane: (4,).

    Returns the points and counts after clipping. A polygon on the other side gets a count of 0.
    """
    distance = points @ plane[:3] + plane[3]
    inside = distance >= 0
    if inside.all():
        return points, counts
    following = np.arange(1, len(points) + 1)
    filled = counts > 0
    starts = first_points(counts)[filled]
    following[starts + counts[filled] - 1] = starts
    crosses = inside != inside[following]
    span = np.where(crosses, distance - distance[following], 1.0)
    intersections = points + (distance / span)[:, None] * (points[following] - points)
    kept = np.stack([inside, crosses], axis=1)
    owner = np.repeat(np.arange(len(counts)), counts)
    new_counts = np.bincount(owner, weights=kept.sum(axis=1), minlength=len(counts)).astype(np.int64)
    return np.stack([points, intersections], axis=1)[kept], new_counts
