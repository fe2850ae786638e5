"""Meshes of cars, trucks, buses, trailers and construction vehicles."""

import numpy as np

from .mesh import MeshBuilder, rectangle
from .surface_colours import BODYWORK, DARK, GLASS, HEADLIGHT, PLATE, RED, RIM, TAIL_LIGHT, TYRE, WHITE, YELLOW

Rng = np.random.Generator


def add_car(builder: MeshBuilder, rng: Rng) -> None:
    """Add a car: an estate or a saloon."""
    body_colour = BODYWORK[rng.integers(len(BODYWORK))]
    estate = rng.random() < 0.45
    builder.add_frustum(rectangle(-0.46, 0.46, 0.45, 0.0), rectangle(-0.46, 0.46, 0.45, 0.2), TYRE, lid=False)
    lower = builder.add_frustum(
        rectangle(-0.49, 0.49, 0.49, 0.13), rectangle(-0.5, 0.5, 0.5, 0.4), body_colour, lid=False
    )
    upper = builder.add_frustum(rectangle(-0.5, 0.5, 0.5, 0.4), rectangle(-0.49, 0.47, 0.47, 0.57), body_colour)
    front, back = lower[0], upper[1]
    builder.add_decal(front, 0.28, 0.72, 0.15, 0.8, DARK)
    builder.add_decal(lower[1], 0.38, 0.62, 0.35, 0.75, PLATE)
    for u in (0.03, 0.77):
        builder.add_decal(front, u, u + 0.2, 0.55, 0.98, HEADLIGHT)
        builder.add_decal(back, u, u + 0.2, 0.1, 0.85, TAIL_LIGHT)
    for x in (-0.31, 0.31):
        builder.add_wheel_pair(x, 0.2)
    rear = (-0.48, -0.43) if estate else (-0.4, -0.24)
    cabin = builder.add_frustum(rectangle(rear[0], 0.23, 0.46, 0.57), rectangle(rear[1], 0.06, 0.38, 1.0), body_colour)
    for quad in cabin[:2]:
        builder.add_decal(quad, 0.06, 0.94, 0.08, 0.86, GLASS)
    for quad in cabin[2:]:
        builder.add_decal(quad, 0.07, 0.48, 0.08, 0.84, GLASS)
        builder.add_decal(quad, 0.53, 0.92, 0.08, 0.84, GLASS)


def add_truck(builder: MeshBuilder, rng: Rng) -> None:
    """Add a truck with a box body; the cab is a separate part."""
    cab, cargo = BODYWORK[rng.integers(len(BODYWORK))], BODYWORK[rng.integers(3)]
    builder.add_frustum(rectangle(-0.49, 0.24, 0.46, 0.0), rectangle(-0.49, 0.24, 0.46, 0.2), DARK, lid=False)
    load = builder.add_frustum(rectangle(-0.5, 0.22, 0.5, 0.2), rectangle(-0.5, 0.22, 0.5, 1.0), cargo)
    builder.add_decal(load[1], 0.48, 0.52, 0.03, 0.97, DARK)
    for u in (0.02, 0.86):
        builder.add_decal(load[1], u, u + 0.12, 0.0, 0.06, TAIL_LIGHT)
    stripe = BODYWORK[rng.integers(4, len(BODYWORK))]
    for quad in load[2:]:
        builder.add_decal(quad, 0.04, 0.96, 0.45, 0.62, stripe)
    builder.add_wheel_pair(-0.3, 0.15)
    builder.start_part()
    builder.add_frustum(rectangle(0.23, 0.49, 0.46, 0.0), rectangle(0.23, 0.49, 0.46, 0.14), DARK, lid=False)
    front, _, left, right = builder.add_frustum(rectangle(0.24, 0.5, 0.5, 0.12), rectangle(0.24, 0.46, 0.48, 0.8), cab)
    builder.add_decal(front, 0.07, 0.93, 0.52, 0.9, GLASS)
    builder.add_decal(front, 0.25, 0.75, 0.12, 0.4, DARK)
    for u in (0.03, 0.81):
        builder.add_decal(front, u, u + 0.16, 0.1, 0.22, HEADLIGHT)
    for quad in (left, right):
        builder.add_decal(quad, 0.2, 0.8, 0.52, 0.9, GLASS)
    builder.add_wheel_pair(0.36, 0.15)


def add_bus(builder: MeshBuilder, rng: Rng) -> None:
    """Add a bus."""
    body_colour = BODYWORK[rng.choice([0, 4, 5, 7, 9])]
    builder.add_frustum(rectangle(-0.49, 0.49, 0.47, 0.0), rectangle(-0.49, 0.49, 0.47, 0.12), DARK, lid=False)
    front, back, left, right = builder.add_frustum(
        rectangle(-0.5, 0.5, 0.5, 0.1), rectangle(-0.5, 0.5, 0.5, 1.0), body_colour
    )
    builder.add_decal(front, 0.05, 0.95, 0.32, 0.82, GLASS)
    builder.add_decal(front, 0.2, 0.8, 0.86, 0.96, YELLOW)
    builder.add_decal(back, 0.15, 0.85, 0.55, 0.85, GLASS)
    for u in (0.04, 0.82):
        builder.add_decal(front, u, u + 0.14, 0.08, 0.18, HEADLIGHT)
        builder.add_decal(back, u, u + 0.14, 0.1, 0.3, TAIL_LIGHT)
    for quad in (left, right):
        builder.add_decal(quad, 0.0, 1.0, 0.3, 0.36, WHITE)
        for u in np.arange(6) / 6:
            builder.add_decal(quad, u + 0.012, u + 0.155, 0.45, 0.85, GLASS)
    for x in (-0.3, 0.33):
        builder.add_wheel_pair(x, 0.14)


def add_trailer(builder: MeshBuilder, rng: Rng) -> None:
    """Add a semi-trailer."""
    body_colour = BODYWORK[rng.choice([0, 1, 4, 5, 8])]
    builder.add_frustum(rectangle(-0.49, -0.12, 0.46, 0.0), rectangle(-0.49, -0.12, 0.46, 0.28), DARK, lid=False)
    builder.add_frustum(rectangle(0.22, 0.26, 0.4, 0.0), rectangle(0.22, 0.26, 0.4, 0.28), DARK, lid=False)
    load = builder.add_frustum(rectangle(-0.5, 0.5, 0.5, 0.26), rectangle(-0.5, 0.5, 0.5, 1.0), body_colour)
    builder.add_decal(load[1], 0.48, 0.52, 0.02, 0.98, DARK)
    builder.add_decal(load[1], 0.0, 1.0, 0.0, 0.06, RED)
    for quad in load[2:]:
        builder.add_decal(quad, 0.0, 1.0, 0.0, 0.07, DARK)
        for u in np.arange(1, 8) / 8:
            builder.add_decal(quad, u - 0.004, u + 0.004, 0.07, 1.0, RIM)
    for x in (-0.42, -0.32, -0.22):
        builder.add_wheel_pair(x, 0.135)


def add_construction_vehicle(builder: MeshBuilder, rng: Rng) -> None:
    """Add an excavator; its arm is a separate part."""
    for side in (-1, 1):
        y0, y1 = sorted((side * 0.26, side * 0.5))
        crawler = (-0.46, 0.3, y0, y1)
        builder.add_frustum((*crawler, 0.0), (*crawler, 0.26), TYRE)
    turret = builder.add_frustum(rectangle(-0.5, 0.12, 0.44, 0.26), rectangle(-0.48, 0.12, 0.44, 0.6), YELLOW)
    for quad in turret[2:]:
        builder.add_decal(quad, 0.55, 0.9, 0.3, 0.7, DARK)
    builder.add_decal(turret[1], 0.2, 0.8, 0.25, 0.75, DARK)
    cab = (-0.14, 0.13, 0.02, 0.44)
    builder.add_frustum((*cab, 0.58), (*cab, 0.95), GLASS)
    builder.add_frustum((*cab, 0.95), (*cab, 1.0), YELLOW)
    builder.start_part()
    boom = ((0.1, 0.45), (0.1, 0.56), (0.3, 0.93), (0.36, 0.86))
    stick = ((0.3, 0.93), (0.38, 0.95), (0.5, 0.3), (0.45, 0.28))
    bucket = ((0.36, 0.05), (0.38, 0.3), (0.5, 0.34), (0.48, 0.0))
    for profile, half_width, colour in ((boom, 0.07, YELLOW), (stick, 0.05, YELLOW), (bucket, 0.2, DARK)):
        builder.add_prism(profile, -0.1 - half_width, -0.1 + half_width, colour)
