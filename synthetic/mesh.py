"""Polygon meshes of objects, and the builder that assembles them from boxes, prisms, wheels and decals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .surface_colours import RIM, TYRE, SurfaceColour

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Mesh:
    """V points in F convex polygons. Within a part, polygons are in rendering order.

    x points along the length (forward), y along the width (left), z up from the ground. The origin is on the ground,
    below the centre of the object's box.

    points: (V, 3) [m].
    counts: (F,) number of points of each polygon.
    normals: (F, 3), unit length.
    areas: (F,) [m²].
    colours: (F, 3) BGR, 0..255, before lighting.
    part_centres: (F, 3) [m], centre of the part that a polygon belongs to. Parts are rendered from far to near.
    solid: (F,) false for a decal on another polygon.
    two_sided: (F,) true for a polygon that is visible from both sides.
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
    """Collects the polygons of a mesh in a unit box, which `build` scales to the size of the object.

    x forward and y left are in -0.5..0.5, z up is in 0..1. The points of a quad are counter-clockwise seen from
    outside, starting at the bottom left.
    """

    def __init__(self, size_m: tuple[float, float, float]) -> None:
        """size_m: width, length, height."""
        self.size_m = size_m
        self._polygons: list[Array] = []
        self._colours: list[SurfaceColour] = []
        self._parts: list[int] = []
        self._solid: list[bool] = []
        self._two_sided: list[bool] = []
        self._part = 0

    def start_part(self) -> None:
        """Start a new part. The polygons added after this call belong to it."""
        self._part += 1

    def add_polygon(
        self, points: ArrayLike, colour: SurfaceColour, solid: bool = True, two_sided: bool = False
    ) -> Array:
        """Add a convex polygon (K, 3) and return its points."""
        self._polygons.append(np.asarray(points, dtype=np.float64))
        self._colours.append(colour)
        self._parts.append(self._part)
        self._solid.append(solid)
        self._two_sided.append(two_sided)
        return self._polygons[-1]

    def add_frustum(
        self, bottom: tuple[float, ...], top: tuple[float, ...], colour: SurfaceColour, lid: bool = True
    ) -> tuple[Array, Array, Array, Array]:
        """Add the sides between two rectangles (x0, x1, y0, y1, z), and the top if `lid`; there is no floor.

        Returns the quads (4, 3) of the front, back, left and right side.
        """
        ax0, ax1, ay0, ay1, az = bottom
        bx0, bx1, by0, by1, bz = top
        front = [(ax1, ay0, az), (ax1, ay1, az), (bx1, by1, bz), (bx1, by0, bz)]
        back = [(ax0, ay1, az), (ax0, ay0, az), (bx0, by0, bz), (bx0, by1, bz)]
        left = [(ax1, ay1, az), (ax0, ay1, az), (bx0, by1, bz), (bx1, by1, bz)]
        right = [(ax0, ay0, az), (ax1, ay0, az), (bx1, by0, bz), (bx0, by0, bz)]
        if lid:
            self.add_polygon([(bx0, by0, bz), (bx1, by0, bz), (bx1, by1, bz), (bx0, by1, bz)], colour)
        return (
            self.add_polygon(front, colour),
            self.add_polygon(back, colour),
            self.add_polygon(left, colour),
            self.add_polygon(right, colour),
        )

    def add_prism(self, profile: Sequence[tuple[float, float]], y0: float, y1: float, colour: SurfaceColour) -> None:
        """Extrude a convex profile from y0 to y1. Its points (x, z) are clockwise seen from the right (-y)."""
        self.add_polygon([(x, y0, z) for x, z in reversed(profile)], colour)
        self.add_polygon([(x, y1, z) for x, z in profile], colour)
        for (xa, za), (xb, zb) in zip(profile, [*profile[1:], profile[0]], strict=True):
            self.add_polygon([(xa, y1, za), (xa, y0, za), (xb, y0, zb), (xb, y1, zb)], colour)

    def add_decal(self, quad: Array, u0: float, u1: float, v0: float, v1: float, colour: SurfaceColour) -> None:
        """Add a rectangle on a quad: u is 0..1 from its left to its right, v from its bottom to its top."""
        self.add_decals(quad, np.array([[u0, u1, v0, v1]]), colour)

    def add_decals(self, quad: Array, rectangles: Array, colour: SurfaceColour) -> None:
        """Add rectangles (n, 4) of u0 u1 v0 v1 on a quad; see `add_decal`."""
        u, v = rectangles[:, [0, 1, 1, 0], None], rectangles[:, [2, 2, 3, 3], None]
        bottom, top = (1 - u) * quad[0] + u * quad[1], (1 - u) * quad[3] + u * quad[2]
        for polygon in (1 - v) * bottom + v * top:
            self.add_polygon(polygon, colour, solid=False)

    def add_wheel_pair(self, x: float, radius: float) -> None:
        """Add a wheel on the left and on the right side, on the ground; radius: a fraction of the height."""
        along = radius * self.size_m[2] / self.size_m[1]
        for y in (0.5, -0.5):
            self.add_polygon(_octagon(x, y, radius, along, radius), TYRE, solid=False)
            self.add_polygon(_octagon(x, y, radius, 0.55 * along, 0.55 * radius), RIM, solid=False)

    def add_middle_wheel(self, x: float, radius: float) -> None:
        """Add the wheel of a bicycle, which is visible from both sides; radius: a fraction of the length."""
        up = radius * self.size_m[1] / self.size_m[2]
        self.add_polygon(_octagon(x, 0.0, up, radius, up), TYRE, two_sided=True)
        self.add_polygon(_octagon(x, 0.0, up, 0.72 * radius, 0.72 * up), RIM, solid=False, two_sided=True)

    def add_revolved(
        self, rings: list[tuple[float, float]], colours: list[SurfaceColour], sides: int, solid: bool = True
    ) -> None:
        """Add a surface of revolution about z.

        rings: (radius, z) from bottom to top.
        colours: one for each band between two rings.
        sides: number of quads per band.
        """
        angles = np.arange(sides) * 2 * np.pi / sides
        circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], axis=1)
        loops = [circle * radius + (0.0, 0.0, z) for radius, z in rings]
        for below, above, colour in zip(loops, loops[1:], colours, strict=False):
            for i in range(sides):
                j = (i + 1) % sides
                self.add_polygon([below[i], below[j], above[j], above[i]], colour, solid)

    def build(self) -> Mesh:
        """Return the mesh of all polygons added so far, in metres."""
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
    """Eight points (8, 3) of an ellipse in a plane of constant y. It faces away from y = 0; for y = 0 it faces left."""
    angles = np.arange(8) * np.pi / 4 * (-1 if y >= 0 else 1)
    return np.stack([x + along * np.cos(angles), np.full(8, y), z + up * np.sin(angles)], axis=1)


def _area_vectors(points: Array, counts: NDArray[np.int64]) -> Array:
    """The normals (F, 3) of polygons, scaled to their areas: half the sum of the cross products of their points."""
    starts = np.cumsum(counts) - counts
    following = np.arange(1, len(points) + 1)
    following[starts + counts - 1] = starts
    return np.add.reduceat(np.cross(points, points[following]), starts, axis=0) / 2


def rectangle(back: float, front: float, half_width: float, z: float) -> tuple[float, ...]:
    """A horizontal rectangle (x0, x1, y0, y1, z) for `MeshBuilder.add_frustum`, symmetric about y = 0."""
    return back, front, -half_width, half_width, z
