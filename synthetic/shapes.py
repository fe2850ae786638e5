"""What stands on the ground, as polygons: the ten classes, and the houses, trees and lamps beside the road.

Each is formed in a box of length, width and height 1: x forward and y left in -0.5..0.5, z up in 0..1.
"""

import numpy as np

from .mesh import RIM, TYRE, Colour, Mesh, MeshBuilder

Rng = np.random.Generator

GLASS: Colour = (72, 58, 46)
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


def build_mesh(name: str, size_m: tuple[float, float, float], rng: Rng) -> Mesh:
    """Build what is called `name` (a class, or "house", "tree", "lamp") to fill a box of (w, l, h)."""
    clay = MeshBuilder(size_m)
    _BUILDERS[name](clay, rng)
    return clay.mesh()


def _car(clay: MeshBuilder, rng: Rng) -> None:
    paint = PAINTS[rng.integers(len(PAINTS))]
    estate = rng.random() < 0.45
    clay.hull(_level(-0.46, 0.46, 0.45, 0.0), _level(-0.46, 0.46, 0.45, 0.2), TYRE, lid=False)
    lower = clay.hull(
        _level(-0.49, 0.49, 0.49, 0.13),
        _level(-0.5, 0.5, 0.5, 0.4),
        paint,
        lid=False,
    )
    upper = clay.hull(_level(-0.5, 0.5, 0.5, 0.4), _level(-0.49, 0.47, 0.47, 0.57), paint)
    front, back = lower[0], upper[1]
    clay.paint(front, 0.28, 0.72, 0.15, 0.8, DARK)
    clay.paint(lower[1], 0.38, 0.62, 0.35, 0.75, PLATE)
    for u in (0.03, 0.77):
        clay.paint(front, u, u + 0.2, 0.55, 0.98, HEADLIGHT)
        clay.paint(back, u, u + 0.2, 0.1, 0.85, TAIL_LIGHT)
    for x in (-0.31, 0.31):
        clay.wheels(x, 0.2)
    rear = (-0.48, -0.43) if estate else (-0.4, -0.24)
    cabin = clay.hull(_level(rear[0], 0.23, 0.46, 0.57), _level(rear[1], 0.06, 0.38, 1.0), paint)
    for quad in cabin[:2]:
        clay.paint(quad, 0.06, 0.94, 0.08, 0.86, GLASS)
    for quad in cabin[2:]:
        clay.paint(quad, 0.07, 0.48, 0.08, 0.84, GLASS)
        clay.paint(quad, 0.53, 0.92, 0.08, 0.84, GLASS)


def _truck(clay: MeshBuilder, rng: Rng) -> None:
    cab, cargo = PAINTS[rng.integers(len(PAINTS))], PAINTS[rng.integers(3)]
    clay.hull(_level(-0.49, 0.24, 0.46, 0.0), _level(-0.49, 0.24, 0.46, 0.2), DARK, lid=False)
    load = clay.hull(_level(-0.5, 0.22, 0.5, 0.2), _level(-0.5, 0.22, 0.5, 1.0), cargo)
    clay.paint(load[1], 0.48, 0.52, 0.03, 0.97, DARK)
    for u in (0.02, 0.86):
        clay.paint(load[1], u, u + 0.12, 0.0, 0.06, TAIL_LIGHT)
    stripe = PAINTS[rng.integers(4, len(PAINTS))]
    for quad in load[2:]:
        clay.paint(quad, 0.04, 0.96, 0.45, 0.62, stripe)
    clay.wheels(-0.3, 0.15)
    clay.next_part()
    clay.hull(_level(0.23, 0.49, 0.46, 0.0), _level(0.23, 0.49, 0.46, 0.14), DARK, lid=False)
    front, _, left, right = clay.hull(_level(0.24, 0.5, 0.5, 0.12), _level(0.24, 0.46, 0.48, 0.8), cab)
    clay.paint(front, 0.07, 0.93, 0.52, 0.9, GLASS)
    clay.paint(front, 0.25, 0.75, 0.12, 0.4, DARK)
    for u in (0.03, 0.81):
        clay.paint(front, u, u + 0.16, 0.1, 0.22, HEADLIGHT)
    for quad in (left, right):
        clay.paint(quad, 0.2, 0.8, 0.52, 0.9, GLASS)
    clay.wheels(0.36, 0.15)


def _bus(clay: MeshBuilder, rng: Rng) -> None:
    paint = PAINTS[rng.choice([0, 4, 5, 7, 9])]
    clay.hull(_level(-0.49, 0.49, 0.47, 0.0), _level(-0.49, 0.49, 0.47, 0.12), DARK, lid=False)
    front, back, left, right = clay.hull(_level(-0.5, 0.5, 0.5, 0.1), _level(-0.5, 0.5, 0.5, 1.0), paint)
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
        clay.wheels(x, 0.14)


def _trailer(clay: MeshBuilder, rng: Rng) -> None:
    paint = PAINTS[rng.choice([0, 1, 4, 5, 8])]
    clay.hull(_level(-0.49, -0.12, 0.46, 0.0), _level(-0.49, -0.12, 0.46, 0.28), DARK, lid=False)
    clay.hull(_level(0.22, 0.26, 0.4, 0.0), _level(0.22, 0.26, 0.4, 0.28), DARK, lid=False)
    load = clay.hull(_level(-0.5, 0.5, 0.5, 0.26), _level(-0.5, 0.5, 0.5, 1.0), paint)
    clay.paint(load[1], 0.48, 0.52, 0.02, 0.98, DARK)
    clay.paint(load[1], 0.0, 1.0, 0.0, 0.06, RED)
    for quad in load[2:]:
        clay.paint(quad, 0.0, 1.0, 0.0, 0.07, DARK)
        for u in np.arange(1, 8) / 8:
            clay.paint(quad, u - 0.004, u + 0.004, 0.07, 1.0, RIM)
    for x in (-0.42, -0.32, -0.22):
        clay.wheels(x, 0.135)


def _construction_vehicle(clay: MeshBuilder, rng: Rng) -> None:
    for side in (-1, 1):
        y0, y1 = sorted((side * 0.26, side * 0.5))
        track = (-0.46, 0.3, y0, y1)
        clay.hull((*track, 0.0), (*track, 0.26), TYRE)
    house = clay.hull(_level(-0.5, 0.12, 0.44, 0.26), _level(-0.48, 0.12, 0.44, 0.6), YELLOW)
    for quad in house[2:]:
        clay.paint(quad, 0.55, 0.9, 0.3, 0.7, DARK)
    clay.paint(house[1], 0.2, 0.8, 0.25, 0.75, DARK)
    cab = (-0.14, 0.13, 0.02, 0.44)
    clay.hull((*cab, 0.58), (*cab, 0.95), GLASS)
    clay.hull((*cab, 0.95), (*cab, 1.0), YELLOW)
    clay.next_part()
    boom = ((0.1, 0.45), (0.1, 0.56), (0.3, 0.93), (0.36, 0.86))
    stick = ((0.3, 0.93), (0.38, 0.95), (0.5, 0.3), (0.45, 0.28))
    bucket = ((0.36, 0.05), (0.38, 0.3), (0.5, 0.34), (0.48, 0.0))
    for profile, half_width, colour in ((boom, 0.07, YELLOW), (stick, 0.05, YELLOW), (bucket, 0.2, DARK)):
        clay.slab(profile, -0.1 - half_width, -0.1 + half_width, colour)


def _barrier(clay: MeshBuilder, rng: Rng) -> None:
    clay.hull(_level(-0.5, 0.5, 0.5, 0.0), _level(-0.5, 0.5, 0.5, 0.15), DARK)
    board = clay.hull(_level(-0.3, 0.3, 0.5, 0.15), _level(-0.2, 0.2, 0.5, 1.0), WHITE)
    for quad in board[:2]:
        for u in np.arange(4) / 4:
            clay.paint(quad, u, u + 0.125, 0.25, 1.0, RED)


def _motorcycle(clay: MeshBuilder, rng: Rng) -> None:
    radius = 0.15
    for x in (radius - 0.5, 0.5 - radius):
        clay.wheel_in_line(x, radius)
    paint = PAINTS[rng.integers(2, len(PAINTS))]
    frame = ((-0.3, 0.25), (-0.4, 0.5), (0.3, 0.55), (0.25, 0.25))
    clay.slab(frame, -0.2, 0.2, paint)
    clay.hull(_level(0.2, 0.26, 0.5, 0.56), _level(0.2, 0.26, 0.5, 0.63), DARK)
    _rider(clay, rng, helmet=PAINTS[rng.integers(len(PAINTS))])


def _bicycle(clay: MeshBuilder, rng: Rng) -> None:
    radius = 0.2
    for x in (radius - 0.5, 0.5 - radius):
        clay.wheel_in_line(x, radius)
    paint = PAINTS[rng.integers(4, len(PAINTS))]
    frame = ((-0.25, 0.3), (-0.15, 0.52), (0.27, 0.56), (0.0, 0.22))
    clay.slab(frame, -0.06, 0.06, paint)
    clay.hull(_level(0.23, 0.27, 0.5, 0.6), _level(0.23, 0.27, 0.5, 0.65), DARK)
    _rider(clay, rng, helmet=PAINTS[rng.integers(len(PAINTS))])


def _rider(clay: MeshBuilder, rng: Rng, helmet: Colour) -> None:
    shirt, trousers = _pick_two(rng)
    clay.hull(
        _level(-0.12, 0.1, 0.34, 0.25),
        _level(-0.16, 0.06, 0.32, 0.55),
        trousers,
        lid=False,
    )
    clay.hull(
        _level(-0.18, 0.04, 0.36, 0.54),
        _level(-0.08, 0.1, 0.42, 0.84),
        shirt,
        lid=False,
    )
    _head(clay, 0.03, 0.83, (0.054, 0.15), helmet)


def _pedestrian(clay: MeshBuilder, rng: Rng) -> None:
    shirt, trousers = _pick_two(rng)
    for side in (-1, 1):
        y0, y1 = sorted((side * 0.03, side * 0.3))
        foot = sorted((side * 0.5, side * 0.2))
        clay.hull((*foot, y0, y1, 0.0), (-0.13, 0.13, y0, y1, 0.48), trousers, lid=False)
    clay.hull(
        _level(-0.16, 0.16, 0.34, 0.46),
        _level(-0.18, 0.18, 0.42, 0.84),
        shirt,
        lid=False,
    )
    for side in (-1, 1):
        y0, y1 = sorted((side * 0.38, side * 0.5))
        hand = sorted((-side * 0.4, -side * 0.2))
        clay.hull((*hand, y0, y1, 0.42), (-0.1, 0.1, y0, y1, 0.82), shirt, lid=False)
    hair = (45, 55, 70) if rng.random() < 0.6 else (90, 130, 165)
    _head(clay, 0.0, 0.84, (0.133, 0.145), hair)


def _head(clay: MeshBuilder, x: float, neck: float, half: tuple[float, float], hair: Colour) -> None:
    """A face that looks forward, below hair or a helmet, from z = `neck` up to 1."""
    around = (x - half[0], x + half[0], -half[1], half[1])
    crown = (x - 0.8 * half[0], x + 0.6 * half[0], -0.8 * half[1], 0.8 * half[1])
    temples = (1 + neck) / 2
    _, back, _, _ = clay.hull((*around, neck), (*around, temples), SKIN, lid=False)
    clay.paint(back, 0.0, 1.0, 0.2, 1.0, hair)
    clay.hull((*around, temples), (*crown, 1.0), hair)


def _traffic_cone(clay: MeshBuilder, rng: Rng) -> None:
    clay.hull(_level(-0.5, 0.5, 0.5, 0.0), _level(-0.5, 0.5, 0.5, 0.06), ORANGE)
    foot, tip = (0.38, 0.06), (0.05, 1.0)
    clay.lathe([foot, tip], [ORANGE], 6)
    for z0, z1 in ((0.3, 0.5), (0.68, 0.86)):
        radii = [(foot[0] + (tip[0] - foot[0]) * (z - 0.06) / 0.94, z) for z in (z0, z1)]
        clay.lathe(radii, [WHITE], 6, solid=False)


def _house(clay: MeshBuilder, rng: Rng) -> None:
    wall = PLASTERS[rng.integers(len(PLASTERS))]
    shop = PAINTS[rng.integers(4, len(PAINTS))]
    walls = clay.hull(_level(-0.5, 0.5, 0.5, 0.0), _level(-0.5, 0.5, 0.5, 1.0), wall)
    wide, long, high = clay.size_m
    floors = max(2, round(high / 3.3))
    pane = (95, 78, 62) if rng.random() < 0.7 else (150, 135, 115)
    for quad, width in zip(walls, (wide, wide, long, long), strict=True):
        clay.paint(quad, 0.0, 1.0, 1 - 0.35 / high, 1.0, DARK)
        columns = max(2, round(width / 3.4))
        grid = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(1, floors) + 0.3) / floors)
        u, v = grid[0].ravel(), grid[1].ravel()
        windows = np.stack([u - 0.24 / columns, u + 0.24 / columns, v, v + 0.5 / floors], axis=1)
        clay.paint_all(quad, windows, pane)
    for quad in walls[2:]:
        clay.paint(quad, 0.05, 0.95, 0.0, 0.62 / floors, GLASS)
        clay.paint(quad, 0.03, 0.97, 0.64 / floors, 0.84 / floors, shop)


def _tree(clay: MeshBuilder, rng: Rng) -> None:
    green = np.array((45, 95, 70)) * rng.uniform(0.75, 1.2) + rng.uniform(0, 18, 3)
    leaves, shade = tuple(green), tuple(green * 0.8)
    clay.lathe([(0.05, 0.0), (0.04, 0.4)], [BARK], 4)
    clay.lathe([(0.2, 0.32), (0.5, 0.55), (0.4, 0.82), (0.1, 1.0)], [shade, leaves, leaves], 8)


def _lamp(clay: MeshBuilder, rng: Rng) -> None:
    clay.hull(_level(-0.3, 0.3, 0.055, 0.0), _level(-0.2, 0.2, 0.035, 1.0), RIM, lid=False)
    clay.hull(_level(-0.5, 0.5, 0.5, 0.97), _level(-0.5, 0.5, 0.5, 1.0), DARK)


def _level(back: float, front: float, half: float, z: float) -> tuple[float, float, float, float, float]:
    """A level rectangle (x0, x1, y0, y1, z), the same to the left as to the right."""
    return back, front, -half, half, z


def _pick_two(rng: Rng) -> tuple[Colour, Colour]:
    first, second = rng.choice(len(CLOTHES), 2, replace=False)
    return CLOTHES[first], CLOTHES[second]


_BUILDERS = {
    "car": _car, "truck": _truck, "construction_vehicle": _construction_vehicle, "bus": _bus,
    "trailer": _trailer, "barrier": _barrier, "motorcycle": _motorcycle, "bicycle": _bicycle,
    "pedestrian": _pedestrian, "traffic_cone": _traffic_cone, "house": _house, "tree": _tree, "lamp": _lamp,
}  # fmt: skip
