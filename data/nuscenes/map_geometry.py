"""The geometry of one location's map in the global frame: the drivable area as polygons, and lane and road dividers."""

from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]


class Paths:
    """N sequences of points.

    points: (V, 2) [m], one path after the other.
    ends: (N,) number of points up to and including each path. Every path has at least one point.
    """

    def __init__(self, points: Array, ends: Numbers) -> None:
        self.points = points
        self.ends = ends

    def __getitem__(self, number: int) -> Array:
        """The points (k, 2) [m] of a path."""
        return self.points[self.ends[number - 1] if number else 0 : self.ends[number]]

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """The least and the greatest coordinates (N, 2) of each path."""
        starts = np.concatenate([[0], self.ends[:-1]]).astype(np.int64)
        if not len(self.ends):
            return np.zeros((0, 2)), np.zeros((0, 2))
        return np.minimum.reduceat(self.points, starts), np.maximum.reduceat(self.points, starts)

    def overlap(self, lower: Array, upper: Array) -> NDArray[np.bool_]:
        """Whether the bounding rectangle of each path overlaps that from `lower` to `upper` (2,), (N,)."""
        least, greatest = self.bounds
        return np.asarray(((least <= upper) & (greatest >= lower)).all(axis=1))


class MapGeometry(NamedTuple):
    """The map of one location.

    rings: the outlines of polygons. The first ring of a polygon is its exterior, the others are its holes.
    polygons: (R,) number of the polygon of each ring, ascending.
    lines: the dividers.
    """

    rings: Paths
    polygons: Numbers
    lines: Paths

    def rings_near(self, lower: Array, upper: Array) -> list[list[Array]]:
        """The rings of each polygon near a rectangle from `lower` to `upper` (2,) [m], without holes far from it."""
        overlaps = self.rings.overlap(lower, upper)
        is_exterior = np.diff(self.polygons, prepend=-1) > 0
        near_polygons = np.isin(self.polygons, self.polygons[is_exterior & overlaps])
        near: list[list[Array]] = []
        for ring in np.flatnonzero(near_polygons & overlaps).tolist():
            if is_exterior[ring]:
                near.append([])
            near[-1].append(self.rings[ring])
        return near

    def lines_near(self, lower: Array, upper: Array) -> list[Array]:
        """The dividers near a rectangle from `lower` to `upper` (2,) [m]."""
        return [self.lines[line] for line in np.flatnonzero(self.lines.overlap(lower, upper)).tolist()]
