"""What stands on the ground, as polygons: the ten classes, and the houses, trees and lamps beside the road.

A mesh fills its box: x along the length (forward), y along the width (left), z up from the ground, the origin
below the box's centre. Colours are BGR, 0..255, before light.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Rng = np.random.Generator
Colour = tuple[float, float, float]

GLASS: Colour = (72, 58, 46)
TYRE: Colour = (34, 33, 32)
RIM: Colour = (150, 148, 146)
DARK: Colour = (48, 46, 45)
HEADLIGHT: Colour = (205, 240, 250)
TAIL_LIGHT: Colour = (40, 30, 190)
PLATE: Colour = (225, 228, 228)
SKIN: Colour = (140, 170, 215)
ORANGE: Colour = (20, 105, 245)
WHITE: Colour = (238, 238, 240)
RED: Colour = (40, 35, 205)
YELLOW: Colour = (25, 180, 240)
BARK: Colour = (55, 72, 92)

PAINTS: tuple[Colour, ...] = (
    (236, 236, 234), (190, 188, 184), (120, 116, 112), (45, 42, 40), (45, 40, 165), (150, 85, 35), (90, 60, 30),
    (85, 110, 60), (150, 185, 200), (35, 120, 200),
)  # fmt: skip
CLOTHES: tuple[Colour, ...] = (
    (60, 45, 40), (130, 70, 45), (50, 50, 150), (170, 160, 150), (60, 110, 60), (50, 160, 200), (110, 60, 110),
    (215, 212, 208), (150, 120, 60),
)  # fmt: skip
PLASTERS: tuple[Colour, ...] = (
    (150, 175, 195), (110, 130, 170), (175, 185, 190), (95, 105, 140), (160, 165, 165), (130, 160, 190), (85, 95, 120),
)  # fmt: skip


@dataclass(frozen=True)
class Mesh:
    """V points in F convex polygons, in the order in which a part's polygons are drawn.

    points: (V, 3) metres; counts: (F,) points per polygon; normals: (F, 3), zero for a polygon that is seen
    from both sides; colours: (F, 3); parts: (F,) index of the polygon's part, part_centres: (P, 3): parts are
    drawn far to near; solid: (F,) false for paint upon another polygon.
    """

    points: Array
    counts: NDArray[np.int64]
    normals: Array
    colours: Array
    parts: NDArray[np.int64]
    part_centres: Array
    solid: NDArray[np.bool_]


class Clay:
    """Collects polygons for a mesh. Quads go counter-clockwise seen from outside, from the bottom left."""

    def __init__(self) -> None:
        self._polygons: list[Array] = []
        self._colours: list[Colour] = []
        self._parts: list[int] = []
        self._solid: list[bool] = []
        self._two_sided: list[bool] = []
        self._part = 0

    def next_part(self) -> None:
        """What follows belongs to another part of the object."""
        self._part += 1

    def polygon(
        self, points: ArrayLike, colour: Colour, solid: bool = True, two_sided: bool = False
    ) -> Array:
        self._polygons.append(np.asarray(points, dtype=np.float64))
        self._colours.append(colour)
        self._parts.append(self._part)
        self._solid.append(solid)
        self._two_sided.append(two_sided)
        return self._polygons[-1]

    def hull(
        self, bottom: tuple[float, ...], top: tuple[float, ...], colour: Colour, ends: Colour | None = None
    ) -> tuple[Array, Array, Array, Array]:
        """A box between two rectangles (x0, x1, y0, y1, z), without a floor; gives front, back, left, right.

        ends: colour of front and back, where it differs.
        """
        ax0, ax1, ay0, ay1, az = bottom
        bx0, bx1, by0, by1, bz = top
        ends = ends or colour
        front = [(ax1, ay0, az), (ax1, ay1, az), (bx1, by1, bz), (bx1, by0, bz)]
        back = [(ax0, ay1, az), (ax0, ay0, az), (bx0, by0, bz), (bx0, by1, bz)]
        left = [(ax1, ay1, az), (ax0, ay1, az), (bx0, by1, bz), (bx1, by1, bz)]
        right = [(ax0, ay0, az), (ax1, ay0, az), (bx1, by0, bz), (bx0, by0, bz)]
        self.polygon([(bx0, by0, bz), (bx1, by0, bz), (bx1, by1, bz), (bx0, by1, bz)], colour)
        return (
            self.polygon(front, ends),
            self.polygon(back, ends),
            self.polygon(left, colour),
            self.polygon(right, colour),
        )

    def paint(self, quad: Array, u0: float, u1: float, v0: float, v1: float, colour: Colour) -> None:
        """A rectangle upon a quad: u runs 0..1 from its left to its right, v from its bottom to its top."""
        u, v = np.array([[u0], [u1], [u1], [u0]]), np.array([[v0], [v0], [v1], [v1]])
        bottom, top = (1 - u) * quad[0] + u * quad[1], (1 - u) * quad[3] + u * quad[2]
        self.polygon((1 - v) * bottom + v * top, colour, solid=False)

    def wheels(self, x: float, half_width: float, radius: float) -> None:
        """A wheel on either side, outermost on the object and touching the ground."""
        for y in (half_width, -half_width):
            self.polygon(_octagon(x, y, radius, radius), TYRE, solid=False)
            self.polygon(_octagon(x, y, radius, radius * 0.55), RIM, solid=False)

    def wheel_in_line(self, x: float, radius: float) -> None:
        """A bicycle's wheel, seen from both sides."""
        self.polygon(_octagon(x, 0.0, radius, radius), TYRE, two_sided=True)
        self.polygon(_octagon(x, 0.0, radius, radius * 0.72), RIM, solid=False, two_sided=True)

    def lathe(self, rings: list[tuple[float, float]], colours: list[Colour], sides: int, x: float = 0.0) -> None:
        """A turned body: rings of (radius, z) from the bottom up, a colour for each band between two."""
        angles = np.arange(sides) * 2 * np.pi / sides
        circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(sides)], axis=1)
        loops = [circle * radius + (x, 0.0, z) for radius, z in rings]
        for below, above, colour in zip(loops, loops[1:], colours, strict=False):
            for i in range(sides):
                j = (i + 1) % sides
                self.polygon([below[i], below[j], above[j], above[i]], colour)
        self.polygon(loops[-1], colours[-1])

    def mesh(self) -> Mesh:
        counts = np.array([len(polygon) for polygon in self._polygons])
        parts = np.array(self._parts)
        middles = np.array([polygon.mean(axis=0) for polygon in self._polygons])
        normals = _normals(np.array([polygon[:3] for polygon in self._polygons]))
        return Mesh(
            points=np.concatenate(self._polygons),
            counts=counts,
            normals=np.where(np.array(self._two_sided)[:, None], 0.0, normals),
            colours=np.array(self._colours),
            parts=parts,
            part_centres=np.array([middles[parts == part].mean(axis=0) for part in range(self._part + 1)]),
            solid=np.array(self._solid),
        )


def build_mesh(name: str, size_m: tuple[float, float, float], rng: Rng) -> Mesh:
    """Build what is called `name` (a class, or "house", "tree", "lamp") to fill a box of (w, l, h)."""
    clay = Clay()
    _BUILDERS[name](clay, *size_m, rng)
    return clay.mesh()


def _car(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    paint = PAINTS[rng.integers(len(PAINTS))]
    estate = rng.random() < 0.45
    clay.hull(_rect(l, w, -0.46, 0.46, 0.45, 0.0), _rect(l, w, -0.46, 0.46, 0.45, 0.2 * h), TYRE)
    low = clay.hull(_rect(l, w, -0.49, 0.49, 0.49, 0.13 * h), _rect(l, w, -0.5, 0.5, 0.5, 0.4 * h), paint)
    high = clay.hull(_rect(l, w, -0.5, 0.5, 0.5, 0.4 * h), _rect(l, w, -0.49, 0.47, 0.47, 0.57 * h), paint)
    front, back = low[0], high[1]
    clay.paint(front, 0.28, 0.72, 0.15, 0.8, DARK)
    clay.paint(low[1], 0.38, 0.62, 0.35, 0.75, PLATE)
    for u in (0.03, 0.77):
        clay.paint(front, u, u + 0.2, 0.55, 0.98, HEADLIGHT)
        clay.paint(back, u, u + 0.2, 0.1, 0.85, TAIL_LIGHT)
    for x in (-0.31, 0.31):
        clay.wheels(x * l, 0.5 * w, 0.2 * h)
    rear = (-0.48, -0.43) if estate else (-0.4, -0.24)
    cabin = clay.hull(
        _rect(l, w, rear[0], 0.23, 0.46, 0.57 * h), _rect(l, w, rear[1], 0.06, 0.38, h), paint
    )
    for quad in cabin[:2]:
        clay.paint(quad, 0.06, 0.94, 0.08, 0.86, GLASS)
    for quad in cabin[2:]:
        clay.paint(quad, 0.07, 0.48, 0.08, 0.84, GLASS)
        clay.paint(quad, 0.53, 0.92, 0.08, 0.84, GLASS)


def _truck(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    cab, cargo = PAINTS[rng.integers(len(PAINTS))], PAINTS[rng.integers(3)]
    clay.hull(_rect(l, w, -0.49, 0.24, 0.46, 0.0), _rect(l, w, -0.49, 0.24, 0.46, 0.2 * h), DARK)
    load = clay.hull(_rect(l, w, -0.5, 0.22, 0.5, 0.2 * h), _rect(l, w, -0.5, 0.22, 0.5, h), cargo)
    clay.paint(load[1], 0.48, 0.52, 0.03, 0.97, DARK)
    for u in (0.02, 0.86):
        clay.paint(load[1], u, u + 0.12, 0.0, 0.06, TAIL_LIGHT)
    stripe = PAINTS[rng.integers(4, len(PAINTS))]
    for quad in load[2:]:
        clay.paint(quad, 0.04, 0.96, 0.45, 0.62, stripe)
    clay.wheels(-0.3 * l, 0.5 * w, 0.15 * h)
    clay.next_part()
    clay.hull(_rect(l, w, 0.23, 0.49, 0.46, 0.0), _rect(l, w, 0.23, 0.49, 0.46, 0.14 * h), DARK)
    front, _, left, right = clay.hull(
        _rect(l, w, 0.24, 0.5, 0.5, 0.12 * h), _rect(l, w, 0.24, 0.46, 0.48, 0.8 * h), cab
    )
    clay.paint(front, 0.07, 0.93, 0.52, 0.9, GLASS)
    clay.paint(front, 0.25, 0.75, 0.12, 0.4, DARK)
    for u in (0.03, 0.81):
        clay.paint(front, u, u + 0.16, 0.1, 0.22, HEADLIGHT)
    for quad in (left, right):
        clay.paint(quad, 0.2, 0.8, 0.52, 0.9, GLASS)
    clay.wheels(0.36 * l, 0.5 * w, 0.15 * h)


def _bus(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    paint = PAINTS[rng.choice([0, 4, 5, 7, 9])]
    clay.hull(_rect(l, w, -0.49, 0.49, 0.47, 0.0), _rect(l, w, -0.49, 0.49, 0.47, 0.12 * h), DARK)
    front, back, left, right = clay.hull(
        _rect(l, w, -0.5, 0.5, 0.5, 0.1 * h), _rect(l, w, -0.5, 0.5, 0.5, h), paint
    )
    clay.paint(front, 0.05, 0.95, 0.32, 0.82, GLASS)
    clay.paint(front, 0.2, 0.8, 0.86, 0.96, YELLOW)
    clay.paint(back, 0.15, 0.85, 0.55, 0.85, GLASS)
    for u in (0.04, 0.82):
        clay.paint(front, u, u + 0.14, 0.08, 0.18, HEADLIGHT)
        clay.paint(back, u, u + 0.14, 0.1, 0.3, TAIL_LIGHT)
    for quad in (left, right):
        clay.paint(quad, 0.0, 1.0, 0.3, 0.36, WHITE)
        for u in np.arange(6) / 6:
            clay.paint(quad, u + 0.012, u + 0.155, 0.45, 0.85, GLASS)
    for x in (-0.3, 0.33):
        clay.wheels(x * l, 0.5 * w, 0.14 * h)


def _trailer(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    paint = PAINTS[rng.choice([0, 1, 4, 5, 8])]
    clay.hull(_rect(l, w, -0.49, -0.12, 0.46, 0.0), _rect(l, w, -0.49, -0.12, 0.46, 0.28 * h), DARK)
    clay.hull(_rect(l, w, 0.22, 0.26, 0.4, 0.0), _rect(l, w, 0.22, 0.26, 0.4, 0.28 * h), DARK)
    load = clay.hull(_rect(l, w, -0.5, 0.5, 0.5, 0.26 * h), _rect(l, w, -0.5, 0.5, 0.5, h), paint)
    clay.paint(load[1], 0.48, 0.52, 0.02, 0.98, DARK)
    clay.paint(load[1], 0.0, 1.0, 0.0, 0.06, RED)
    for quad in load[2:]:
        clay.paint(quad, 0.0, 1.0, 0.0, 0.07, DARK)
        for u in np.arange(1, 8) / 8:
            clay.paint(quad, u - 0.004, u + 0.004, 0.07, 1.0, RIM)
    for x in (-0.42, -0.32, -0.22):
        clay.wheels(x * l, 0.5 * w, 0.135 * h)


def _construction_vehicle(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    for side in (-1, 1):
        y0, y1 = sorted((side * 0.26 * w, side * 0.5 * w))
        track = (-0.46 * l, 0.3 * l, y0, y1)
        clay.hull((*track, 0.0), (*track, 0.26 * h), TYRE)
    house = clay.hull(_rect(l, w, -0.5, 0.12, 0.44, 0.26 * h), _rect(l, w, -0.48, 0.12, 0.44, 0.6 * h), YELLOW)
    for quad in house[2:]:
        clay.paint(quad, 0.55, 0.9, 0.3, 0.7, DARK)
    clay.paint(house[1], 0.2, 0.8, 0.25, 0.75, DARK)
    cab = (-0.14 * l, 0.13 * l, 0.02 * w, 0.44 * w)
    clay.hull((*cab, 0.58 * h), (*cab, 0.95 * h), GLASS)
    clay.hull((*cab, 0.95 * h), (*cab, h), YELLOW)
    clay.next_part()
    boom = ((0.1, 0.45), (0.1, 0.56), (0.3, 0.93), (0.36, 0.86))
    stick = ((0.3, 0.93), (0.38, 0.95), (0.5, 0.3), (0.45, 0.28))
    bucket = ((0.36, 0.05), (0.38, 0.3), (0.5, 0.34), (0.48, 0.0))
    for profile, half_width, colour in ((boom, 0.07, YELLOW), (stick, 0.05, YELLOW), (bucket, 0.2, DARK)):
        _slab(clay, [(x * l, z * h) for x, z in profile], -half_width * w - 0.1 * w, half_width * w - 0.1 * w, colour)


def _barrier(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    clay.hull(_rect(l, w, -0.5, 0.5, 0.5, 0.0), _rect(l, w, -0.5, 0.5, 0.5, 0.15 * h), DARK)
    board = clay.hull(_rect(l, w, -0.3, 0.3, 0.5, 0.15 * h), _rect(l, w, -0.2, 0.2, 0.5, h), WHITE)
    for quad in board[:2]:
        for u in np.arange(4) / 4:
            clay.paint(quad, u, u + 0.125, 0.25, 1.0, RED)


def _motorcycle(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    radius = 0.15 * l
    for x in (radius - 0.5 * l, 0.5 * l - radius):
        clay.wheel_in_line(x, radius)
    paint = PAINTS[rng.integers(2, len(PAINTS))]
    _slab(clay, [(x * l, z * h) for x, z in ((-0.3, 0.25), (-0.4, 0.5), (0.3, 0.55), (0.25, 0.25))],
          -0.2 * w, 0.2 * w, paint)  # fmt: skip
    clay.hull(_rect(l, w, 0.2, 0.26, 0.5, 0.56 * h), _rect(l, w, 0.2, 0.26, 0.5, 0.63 * h), DARK)
    _rider(clay, w, l, h, rng, helmet=PAINTS[rng.integers(len(PAINTS))])


def _bicycle(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    radius = 0.2 * l
    for x in (radius - 0.5 * l, 0.5 * l - radius):
        clay.wheel_in_line(x, radius)
    paint = PAINTS[rng.integers(4, len(PAINTS))]
    _slab(clay, [(x * l, z * h) for x, z in ((-0.25, 0.3), (-0.15, 0.52), (0.27, 0.56), (0.0, 0.22))],
          -0.06 * w, 0.06 * w, paint)  # fmt: skip
    clay.hull(_rect(l, w, 0.23, 0.27, 0.5, 0.6 * h), _rect(l, w, 0.23, 0.27, 0.5, 0.65 * h), DARK)
    _rider(clay, w, l, h, rng, helmet=PAINTS[rng.integers(len(PAINTS))])


def _rider(clay: Clay, w: float, l: float, h: float, rng: Rng, helmet: Colour) -> None:  # noqa: E741
    shirt, trousers = _pick_two(rng)
    clay.hull(_rect(l, w, -0.12, 0.1, 0.34, 0.25 * h), _rect(l, w, -0.16, 0.06, 0.32, 0.55 * h), trousers)
    clay.hull(_rect(l, w, -0.18, 0.04, 0.36, 0.54 * h), _rect(l, w, -0.08, 0.1, 0.42, 0.84 * h), shirt)
    clay.lathe([(0.07 * h, 0.83 * h), (0.09 * h, 0.9 * h), (0.06 * h, h)], [SKIN, helmet], 7, x=0.03 * l)


def _pedestrian(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    shirt, trousers = _pick_two(rng)
    for side in (-1, 1):
        y0, y1 = sorted((side * 0.03 * w, side * 0.3 * w))
        foot = sorted((side * 0.5 * l, side * 0.2 * l))
        clay.hull((*foot, y0, y1, 0.0), (-0.13 * l, 0.13 * l, y0, y1, 0.48 * h), trousers)
    clay.hull(_rect(l, w, -0.16, 0.16, 0.34, 0.46 * h), _rect(l, w, -0.18, 0.18, 0.42, 0.84 * h), shirt)
    for side in (-1, 1):
        y0, y1 = sorted((side * 0.38 * w, side * 0.5 * w))
        hand = sorted((-side * 0.4 * l, -side * 0.2 * l))
        clay.hull((*hand, y0, y1, 0.42 * h), (-0.1 * l, 0.1 * l, y0, y1, 0.82 * h), shirt)
    hair = (45, 55, 70) if rng.random() < 0.6 else (90, 130, 165)
    clay.lathe([(0.05 * h, 0.84 * h), (0.068 * h, 0.92 * h), (0.045 * h, h)], [SKIN, hair], 7)


def _traffic_cone(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    clay.hull(_rect(l, w, -0.5, 0.5, 0.5, 0.0), _rect(l, w, -0.5, 0.5, 0.5, 0.06 * h), ORANGE)
    radii = [(0.38 * w, 0.06 * h), (0.29 * w, 0.32 * h), (0.21 * w, 0.54 * h), (0.13 * w, 0.76 * h), (0.05 * w, h)]
    clay.lathe(radii, [ORANGE, WHITE, ORANGE, WHITE], 8)


def _house(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    wall = PLASTERS[rng.integers(len(PLASTERS))]
    shop = PAINTS[rng.integers(4, len(PAINTS))]
    walls = clay.hull(_rect(l, w, -0.5, 0.5, 0.5, 0.0), _rect(l, w, -0.5, 0.5, 0.5, h), wall)
    floors = max(2, round(h / 3.3))
    pane = (95, 78, 62) if rng.random() < 0.7 else (150, 135, 115)
    for quad, width in zip(walls, (w, w, l, l), strict=True):
        clay.paint(quad, 0.0, 1.0, 1 - 0.35 / h, 1.0, DARK)
        columns = max(2, round(width / 3.4))
        for u in (np.arange(columns) + 0.5) / columns:
            for floor in range(1, floors):
                v = (floor + 0.3) / floors
                clay.paint(quad, u - 0.24 / columns, u + 0.24 / columns, v, v + 0.5 / floors, pane)
    for quad in walls[2:]:
        clay.paint(quad, 0.05, 0.95, 0.0, 0.62 / floors, GLASS)
        clay.paint(quad, 0.03, 0.97, 0.64 / floors, 0.84 / floors, shop)


def _tree(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    green = np.array((45, 95, 70)) * rng.uniform(0.75, 1.2) + rng.uniform(0, 18, 3)
    leaves, shade = tuple(green), tuple(green * 0.8)
    clay.lathe([(0.16, 0.0), (0.12, 0.4 * h)], [BARK], 6)
    rings = [(0.14 * w, 0.32 * h), (0.44 * w, 0.45 * h), (0.5 * w, 0.62 * h), (0.38 * w, 0.84 * h), (0.12 * w, h)]
    clay.lathe(rings, [shade, shade, leaves, leaves], 8)


def _lamp(clay: Clay, w: float, l: float, h: float, rng: Rng) -> None:  # noqa: E741
    clay.lathe([(0.09, 0.0), (0.06, h)], [RIM], 5)
    clay.hull((-0.12, 0.12, -0.5 * w, 0.5 * w, h - 0.15), (-0.12, 0.12, -0.5 * w, 0.5 * w, h), DARK)


def _rect(
    length: float, width: float, back: float, front: float, half: float, z: float
) -> tuple[float, float, float, float, float]:
    """A level rectangle (x0, x1, y0, y1, z) from fractions of length and width."""
    return back * length, front * length, -half * width, half * width, z


def _slab(clay: Clay, profile: list[tuple[float, float]], y0: float, y1: float, colour: Colour) -> None:
    """A convex profile of (x, z), clockwise seen from the right (-y), drawn out from y0 to y1."""
    clay.polygon([(x, y0, z) for x, z in reversed(profile)], colour)
    clay.polygon([(x, y1, z) for x, z in profile], colour)
    for (xa, za), (xb, zb) in zip(profile, profile[1:] + profile[:1], strict=True):
        clay.polygon([(xa, y1, za), (xa, y0, za), (xb, y0, zb), (xb, y1, zb)], colour)


def _octagon(x: float, y: float, z: float, radius: float) -> Array:
    """Eight points in a plane of constant y, facing away from y = 0 (to the left where y is 0)."""
    angles = np.arange(8) * np.pi / 4 * (-1 if y >= 0 else 1)
    return np.stack([x + radius * np.cos(angles), np.full(8, y), z + radius * np.sin(angles)], axis=1)


def _pick_two(rng: Rng) -> tuple[Colour, Colour]:
    first, second = rng.choice(len(CLOTHES), 2, replace=False)
    return CLOTHES[first], CLOTHES[second]


def _normals(triangles: Array) -> Array:
    """Unit normals (F, 3) of counter-clockwise triangles (F, 3, 3)."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 1])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


_BUILDERS = {
    "car": _car, "truck": _truck, "construction_vehicle": _construction_vehicle, "bus": _bus,
    "trailer": _trailer, "barrier": _barrier, "motorcycle": _motorcycle, "bicycle": _bicycle,
    "pedestrian": _pedestrian, "traffic_cone": _traffic_cone, "house": _house, "tree": _tree, "lamp": _lamp,
}  # fmt: skip
