"""Meshes of barriers and traffic cones, and of the scenery: houses, trees and lamps."""

import numpy as np

from .mesh import MeshBuilder, rectangle
from .surface_colours import BARK, BODYWORK, DARK, GLASS, ORANGE, PLASTER, RED, RIM, WHITE

Rng = np.random.Generator


def add_barrier(builder: MeshBuilder, rng: Rng) -> None:
    """Add a striped barrier."""
    builder.add_frustum(rectangle(-0.5, 0.5, 0.5, 0.0), rectangle(-0.5, 0.5, 0.5, 0.15), DARK)
    board = builder.add_frustum(rectangle(-0.3, 0.3, 0.5, 0.15), rectangle(-0.2, 0.2, 0.5, 1.0), WHITE)
    for quad in board[:2]:
        for u in np.arange(4) / 4:
            builder.add_decal(quad, u, u + 0.125, 0.25, 1.0, RED)


def add_traffic_cone(builder: MeshBuilder, rng: Rng) -> None:
    """Add a traffic cone with two white bands."""
    builder.add_frustum(rectangle(-0.5, 0.5, 0.5, 0.0), rectangle(-0.5, 0.5, 0.5, 0.06), ORANGE)
    foot, tip = (0.38, 0.06), (0.05, 1.0)
    builder.add_revolved([foot, tip], [ORANGE], 6)
    for z0, z1 in ((0.3, 0.5), (0.68, 0.86)):
        radii = [(foot[0] + (tip[0] - foot[0]) * (z - 0.06) / 0.94, z) for z in (z0, z1)]
        builder.add_revolved(radii, [WHITE], 6, solid=False)


def add_house(builder: MeshBuilder, rng: Rng) -> None:
    """Add a house with a shop on the ground floor."""
    wall = PLASTER[rng.integers(len(PLASTER))]
    shop = BODYWORK[rng.integers(4, len(BODYWORK))]
    walls = builder.add_frustum(rectangle(-0.5, 0.5, 0.5, 0.0), rectangle(-0.5, 0.5, 0.5, 1.0), wall)
    wide, long, high = builder.size_m
    floors = max(2, round(high / 3.3))
    pane = (95, 78, 62) if rng.random() < 0.7 else (150, 135, 115)
    for quad, width in zip(walls, (wide, wide, long, long), strict=True):
        builder.add_decal(quad, 0.0, 1.0, 1 - 0.35 / high, 1.0, DARK)
        columns = max(2, round(width / 3.4))
        grid = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(1, floors) + 0.3) / floors)
        u, v = grid[0].ravel(), grid[1].ravel()
        windows = np.stack([u - 0.24 / columns, u + 0.24 / columns, v, v + 0.5 / floors], axis=1)
        builder.add_decals(quad, windows, pane)
    for quad in walls[2:]:
        builder.add_decal(quad, 0.05, 0.95, 0.0, 0.62 / floors, GLASS)
        builder.add_decal(quad, 0.03, 0.97, 0.64 / floors, 0.84 / floors, shop)


def add_tree(builder: MeshBuilder, rng: Rng) -> None:
    """Add a tree with a round crown."""
    green = np.array((45, 95, 70)) * rng.uniform(0.75, 1.2) + rng.uniform(0, 18, 3)
    leaves, shade = tuple(green), tuple(green * 0.8)
    builder.add_revolved([(0.05, 0.0), (0.04, 0.4)], [BARK], 4)
    builder.add_revolved([(0.2, 0.32), (0.5, 0.55), (0.4, 0.82), (0.1, 1.0)], [shade, leaves, leaves], 8)


def add_lamp(builder: MeshBuilder, rng: Rng) -> None:
    """Add a street lamp."""
    builder.add_frustum(rectangle(-0.3, 0.3, 0.055, 0.0), rectangle(-0.2, 0.2, 0.035, 1.0), RIM, lid=False)
    builder.add_frustum(rectangle(-0.5, 0.5, 0.5, 0.97), rectangle(-0.5, 0.5, 0.5, 1.0), DARK)
