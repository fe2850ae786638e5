"""Polygon meshes and the hands that form them: boxes, slabs, turned bodies, wheels and paint."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Colour = tuple[float, float, float]  # BGR, 0..255, before light

TYRE: Colour = (34, 33, 32)
RIM: Colour = (150, 148, 146)


@dataclass(frozen=True)
class Mesh:
    """V points in F convex polygons, in the order in which a part's polygons are drawn.

    x lies along the length (forward), y along the width (left), z up from the ground; the origin lies below
    the box's centre.

    points: (V, 3) metres; counts: (F,) points per polygon; normals: (F, 3), unit; areas: (F,) square metres;
    colours: (F, 3); part_centres: (F, 3): the middle of the part a polygon belongs to; parts are drawn far to
    near; solid: (F,) false for paint upon another polygon; two_sided: (F,) true where the back is seen as well.
    """

    points: Array
    counts: NDArray[np.int64]
    normals: Array
    areas: Array
    colours: Array
    part_centres: Array
    solid: NDArray[np.bool_]
    two_sided: NDArray[np.bool_]


class MeshBuilder:
    """Collects the polygons of a mesh, in a box of length, width and height 1 that is stretched to size at last.

    x forward and y left in -0.5..0.5, z up in 0..1. Quads go counter-clockwise seen from outside, from the bottom
    left.
    """

    def __init__(self, size_m: tuple[float, float, float]) -> None:
        """size_m: width, length, height."""
        self.size_m = size_m
        self._polygons: list[Array] = []
        self._colours: list[Colour] = []
        self._parts: list[int] = []
        self._solid: list[bool] = []
        self._two_sided: list[bool] = []
        self._part = 0

    def next_part(self) -> None:
        """What follows belongs to another part of the object."""
        self._part += 1

    def polygon(self, points: ArrayLike, colour: Colour, solid: bool = True, two_sided: bool = False) -> Array:
        self._polygons.append(np.asarray(points, dtype=np.float64))
        self._colours.append(colour)
        self._parts.append(self._part)
        self._solid.append(solid)
        self._two_sided.append(two_sided)
        return self._polygons[-1]

    def hull(
        self, bottom: tuple[float, ...], top: tuple[float, ...], colour: Colour, lid: bool = True
    ) -> tuple[Array, Array, Array, Array]:
        """A box between two rectangles (x0, x1, y0, y1, z), without a floor; gives front, back, left, right."""
        ax0, ax1, ay0, ay1, az = bottom
        bx0, bx1, by0, by1, bz = top
        front = [(ax1, ay0, az), (ax1, ay1, az), (bx1, by1, bz), (bx1, by0, bz)]
        back = [(ax0, ay1, az), (ax0, ay0, az), (bx0, by0, bz), (bx0, by1, bz)]
        left = [(ax1, ay1, az), (ax0, ay1, az), (bx0, by1, bz), (bx1, by1, bz)]
        right = [(ax0, ay0, az), (ax1, ay0, az), (bx1, by0, bz), (bx0, by0, bz)]
        if lid:
            self.polygon([(bx0, by0, bz), (bx1, by0, bz), (bx1, by1, bz), (bx0, by1, bz)], colour)
        return (
            self.polygon(front, colour),
            self.polygon(back, colour),
            self.polygon(left, colour),
            self.polygon(right, colour),
        )

    def slab(self, profile: Sequence[tuple[float, float]], y0: float, y1: float, colour: Colour) -> None:
        """A convex profile of (x, z), clockwise seen from the right (-y), drawn out from y0 to y1."""
        self.polygon([(x, y0, z) for x, z in reversed(profile)], colour)
        self.polygon([(x, y1, z) for x, z in profile], colour)
        for (xa, za), (xb, zb) in zip(profile, [*profile[1:], profile[0]], strict=True):
            self.polygon([(xa, y1, za), (xa, y0, za), (xb, y0, zb), (xb, y1, zb)], colour)

    def paint(self, quad: Array, u0: float, u1: float, v0: float, v1: float, colour: Colour) -> None:
        """A rectangle upon a quad: u runs 0..1 from its left to its right, v from its bottom to its top."""
        self.paint_all(quad, np.array([[u0, u1, v0, v1]]), colour)

    def paint_all(self, quad: Array, rectangles: Array, colour: Colour) -> None:
        """Rectangles (n, 4) u0 u1 v0 v1 upon a quad, see `paint`."""
        u, v = rectangles[:, [0, 1, 1, 0], None], rectangles[:, [2, 2, 3, 3], None]
        bottom, top = (1 - u) * quad[0] + u * quad[1], (1 - u) * quad[3] + u * quad[2]
        for polygon in (1 - v) * bottom + v * top:
            self.polygon(polygon, colour, solid=False)

    def wheels(self, x: float, radius: float) -> None:
        """A wheel on either side, outermost and touching the ground; radius: a fraction of the height."""
        along = radius * self.size_m[2] / self.size_m[1]
        for y in (0.5, -0.5):
            self.polygon(_octagon(x, y, radius, along, radius), TYRE, solid=False)
            self.polygon(_octagon(x, y, radius, 0.55 * along, 0.55 * radius), RIM, solid=False)

    def wheel_in_line(self, x: float, radius: float) -> None:
        """A bicycle's wheel, seen from both sides; radius: a fraction of the length."""
        up = radius * self.size_m[1] / self.size_m[2]
        self.polygon(_octagon(x, 0.0, up, radius, up), TYRE, two_sided=True)
        self.polygon(_octagon(x, 0.0, up, 0.72 * radius, 0.72 * up), RIM, solid=False, two_sided=True)

    def lathe(self, rings: list[tuple[float, float]], colours: list[Colour], sides: int, solid: bool = True) -> None:
        """A turned body: rings of (radius, z) from the bottom up, a colour for each band between two."""
        angles = np.arange(sides) * 2 * np.pi / sides
        circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], axis=1)
        loops = [circle * radius + (0.0, 0.0, z) for radius, z in rings]
        for below, above, colour in zip(loops, loops[1:], colours, strict=False):
            for i in range(sides):
                j = (i + 1) % sides
                self.polygon([below[i], below[j], above[j], above[i]], colour, solid)

    def mesh(self) -> Mesh:
        width, length, height = self.size_m
        points = np.concatenate(self._polygons) * (length, width, height)
        counts = np.array([len(polygon) for polygon in self._polygons])
        vectors = _area_vectors(points, counts)
        areas = np.linalg.norm(vectors, axis=1)
        parts = np.array(self._parts)
        part_of_point = np.repeat(parts, counts)
        centres = np.array([points[part_of_point == part].mean(axis=0) for part in range(self._part + 1)])
        return Mesh(
            points=points,
            counts=counts,
            normals=vectors / areas[:, None],
            areas=areas,
            colours=np.array(self._colours),
            part_centres=centres[parts],
            solid=np.array(self._solid),
            two_sided=np.array(self._two_sided),
        )


def _octagon(x: float, y: float, z: float, along: float, up: float) -> Array:
    """Eight points of an ellipse of constant y, facing away from y = 0 (to the left where y is 0)."""
    angles = np.arange(8) * np.pi / 4 * (-1 if y >= 0 else 1)
    return np.stack([x + along * np.cos(angles), np.full(8, y), z + up * np.sin(angles)], axis=1)


def _area_vectors(points: Array, counts: NDArray[np.int64]) -> Array:
    """Half the sum of the cross products round each polygon: its normal, as long as its area; (F, 3)."""
    starts = np.cumsum(counts) - counts
    following = np.arange(1, len(points) + 1)
    following[starts + counts - 1] = starts
    return np.add.reduceat(np.cross(points, points[following]), starts, axis=0) / 2
