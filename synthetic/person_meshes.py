"""Meshes of pedestrians, and of bicycles and motorcycles with their riders."""

import numpy as np

from .mesh import MeshBuilder, rectangle
from .surface_colours import BODYWORK, CLOTHES, DARK, SKIN, SurfaceColour

Rng = np.random.Generator


def add_pedestrian(builder: MeshBuilder, rng: Rng) -> None:
    """Add a walking pedestrian."""
    shirt, trousers = _choose_clothes(rng)
    for side in (-1, 1):
        y0, y1 = sorted((side * 0.03, side * 0.3))
        foot = sorted((side * 0.5, side * 0.2))
        builder.add_frustum((*foot, y0, y1, 0.0), (-0.13, 0.13, y0, y1, 0.48), trousers, lid=False)
    builder.add_frustum(rectangle(-0.16, 0.16, 0.34, 0.46), rectangle(-0.18, 0.18, 0.42, 0.84), shirt, lid=False)
    for side in (-1, 1):
        y0, y1 = sorted((side * 0.38, side * 0.5))
        hand = sorted((-side * 0.4, -side * 0.2))
        builder.add_frustum((*hand, y0, y1, 0.42), (-0.1, 0.1, y0, y1, 0.82), shirt, lid=False)
    hair = (45, 55, 70) if rng.random() < 0.6 else (90, 130, 165)
    _add_head(builder, 0.0, 0.84, (0.133, 0.145), hair)


def add_motorcycle(builder: MeshBuilder, rng: Rng) -> None:
    """Add a motorcycle with its rider."""
    radius = 0.15
    for x in (radius - 0.5, 0.5 - radius):
        builder.add_middle_wheel(x, radius)
    body_colour = BODYWORK[rng.integers(2, len(BODYWORK))]
    frame = ((-0.3, 0.25), (-0.4, 0.5), (0.3, 0.55), (0.25, 0.25))
    builder.add_prism(frame, -0.2, 0.2, body_colour)
    builder.add_frustum(rectangle(0.2, 0.26, 0.5, 0.56), rectangle(0.2, 0.26, 0.5, 0.63), DARK)
    _add_rider(builder, rng, helmet=BODYWORK[rng.integers(len(BODYWORK))])


def add_bicycle(builder: MeshBuilder, rng: Rng) -> None:
    """Add a bicycle with its rider."""
    radius = 0.2
    for x in (radius - 0.5, 0.5 - radius):
        builder.add_middle_wheel(x, radius)
    body_colour = BODYWORK[rng.integers(4, len(BODYWORK))]
    frame = ((-0.25, 0.3), (-0.15, 0.52), (0.27, 0.56), (0.0, 0.22))
    builder.add_prism(frame, -0.06, 0.06, body_colour)
    builder.add_frustum(rectangle(0.23, 0.27, 0.5, 0.6), rectangle(0.23, 0.27, 0.5, 0.65), DARK)
    _add_rider(builder, rng, helmet=BODYWORK[rng.integers(len(BODYWORK))])


def _add_rider(builder: MeshBuilder, rng: Rng, helmet: SurfaceColour) -> None:
    shirt, trousers = _choose_clothes(rng)
    builder.add_frustum(rectangle(-0.12, 0.1, 0.34, 0.25), rectangle(-0.16, 0.06, 0.32, 0.55), trousers, lid=False)
    builder.add_frustum(rectangle(-0.18, 0.04, 0.36, 0.54), rectangle(-0.08, 0.1, 0.42, 0.84), shirt, lid=False)
    _add_head(builder, 0.03, 0.83, (0.054, 0.15), helmet)


def _add_head(builder: MeshBuilder, x: float, neck: float, half: tuple[float, float], hair: SurfaceColour) -> None:
    """Add a face, and above it hair or a helmet, from z = `neck` up to 1; half: half its length and width."""
    around = (x - half[0], x + half[0], -half[1], half[1])
    crown = (x - 0.8 * half[0], x + 0.6 * half[0], -0.8 * half[1], 0.8 * half[1])
    temples = (1 + neck) / 2
    _, back, _, _ = builder.add_frustum((*around, neck), (*around, temples), SKIN, lid=False)
    builder.add_decal(back, 0.0, 1.0, 0.2, 1.0, hair)
    builder.add_frustum((*around, temples), (*crown, 1.0), hair)


def _choose_clothes(rng: Rng) -> tuple[SurfaceColour, SurfaceColour]:
    first, second = rng.choice(len(CLOTHES), 2, replace=False)
    return CLOTHES[first], CLOTHES[second]
