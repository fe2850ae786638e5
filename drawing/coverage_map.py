"""The coverage map of a rig: the number of cameras that see each place on the ground. Forward is up, left is left."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .bird_eye_view import draw_ego, draw_rings, to_view_pixels
from .box_style import CLASS_COLOURS
from .camera_panel import TEXT_COLOUR
from .canvas import Colour, Picture, draw_circle, draw_outline, draw_text, fitting_height_px, text_width_px
from .footer import draw_legend_bar, draw_text_bar

Array = NDArray[np.float64]

COUNT_COLOURS: dict[str, Colour] = {  # BGR, by the number of cameras that see a cell
    "0": (38, 30, 92),
    "1": (96, 70, 40),
    "2": (128, 122, 40),
    "3+": (70, 165, 120),
}
OUTSIDE_COLOUR: Colour = (18, 15, 14)
SHADOW_COLOUR: Colour = (20, 20, 20)
SIZE_PX = 1000
WEDGE_SHARE = 0.5  # length of a wedge, as a share of the range
NAME_PX, NAME_SPACING, PAD_PX = 16.0, 1.7, 6.0
# The positions that are tried for a name, in order: distances from the end of its wedge, as shares of the range.
NAME_STEPS = (0.0, 0.06, 0.12, 0.18, 0.24, -0.3, -0.36, -0.42)


class Wedge(NamedTuple):
    """The horizontal field of view of a camera.

    position_m: (2,) of the camera, x and y in the ego frame.
    left_rad, middle_rad, right_rad: azimuths of its borders and of its middle.
    """

    name: str
    position_m: Array
    left_rad: float
    middle_rad: float
    right_rad: float


class GroundCoverage(NamedTuple):
    """The number of cameras that see each cell of the ground.

    num_cameras: (X, Y). Cell [i, j] is at x_i (forward) and y_j (left).
    lower_m, upper_m: x and y of the borders of the grid.
    """

    num_cameras: NDArray[np.int64]
    lower_m: tuple[float, float]
    upper_m: tuple[float, float]


def draw_coverage_map(ground: GroundCoverage, wedges: Sequence[Wedge], notes: Sequence[tuple[str, Colour]]) -> Picture:
    """Draw the map, and below it its legend and notes: (H, SIZE_PX, 3) uint8 BGR.

    wedges: the field of view of each camera.
    notes: texts and their colours.
    """
    range_m = float(np.abs([*ground.lower_m, *ground.upper_m]).max())
    view = draw_counts(ground, range_m, SIZE_PX)
    draw_rings(view, range_m, 1.2)
    draw_ego(view, range_m, 1.0)
    colours = wedge_colours(wedges)
    for wedge in wedges:
        draw_outline(view, to_view_pixels(wedge_outline(wedge, range_m), range_m, SIZE_PX), colours[wedge.name], 2)
        u, v = to_view_pixels(wedge.position_m, range_m, SIZE_PX)
        draw_circle(view, (float(u), float(v)), 4, colours[wedge.name], -1)
    _draw_names(view, wedges, colours, range_m)
    legend = {f"{count} camera{'' if count == '1' else 's'}": colour for count, colour in COUNT_COLOURS.items()}
    notes = [("number of cameras that see the road (z = 0)", TEXT_COLOUR), *notes]
    return np.concatenate([view, draw_legend_bar(legend, SIZE_PX), draw_text_bar(notes, SIZE_PX)])


def draw_counts(ground: GroundCoverage, range_m: float, size_px: int) -> Picture:
    """Draw the cells in the colours of their counts: (size_px, size_px, 3), for [-range_m, range_m] in x and y."""
    ahead_m = range_m - (np.arange(size_px) + 0.5) * 2 * range_m / size_px  # x of each row, and y of each column
    rows, columns = (
        np.floor((ahead_m - lower) / (upper - lower) * size).astype(int)
        for lower, upper, size in zip(ground.lower_m, ground.upper_m, ground.num_cameras.shape, strict=True)
    )
    palette = np.array([*COUNT_COLOURS.values(), OUTSIDE_COLOUR], dtype=np.uint8)
    padded = np.pad(np.minimum(ground.num_cameras, len(COUNT_COLOURS) - 1), 1, constant_values=len(COUNT_COLOURS))
    padded_indices = [
        np.clip(index + 1, 0, size + 1) for index, size in zip((rows, columns), ground.num_cameras.shape, strict=True)
    ]
    return palette[padded[np.ix_(*padded_indices)]]


def wedge_outline(wedge: Wedge, range_m: float) -> Array:
    """The outline (K, 2) [m] of a wedge: the position of the camera, and an arc from the left to the right border."""
    right = wedge.left_rad - (wedge.left_rad - wedge.right_rad) % (2 * np.pi)
    angles = np.linspace(wedge.left_rad, right, 33)
    arc = wedge.position_m + WEDGE_SHARE * range_m * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return np.vstack([wedge.position_m, arc])


def wedge_colours(wedges: Sequence[Wedge]) -> dict[str, Colour]:
    """A colour for each camera, by name. Colours repeat if there are more cameras than colours."""
    palette = list(CLASS_COLOURS.values())
    return {wedge.name: palette[index % len(palette)] for index, wedge in enumerate(wedges)}


def _draw_names(view: Picture, wedges: Sequence[Wedge], colours: Mapping[str, Colour], range_m: float) -> None:
    """Write each name at the far end of its wedge, inside the map. Names do not overlap as long as there is room."""
    taken = np.zeros(view.shape[:2], dtype=bool)
    for wedge in wedges:
        height_px = fitting_height_px(wedge.name, NAME_PX, SIZE_PX / 3)
        width_px = text_width_px(wedge.name, height_px)
        outward = np.array([-np.sin(wedge.middle_rad), -np.cos(wedge.middle_rad)])  # in pixels: right, down
        areas = []
        for step in NAME_STEPS:
            away_px = (WEDGE_SHARE + step) * SIZE_PX / 2 + NAME_PX + width_px / 2 * abs(outward[0])
            u, v = to_view_pixels(wedge.position_m, range_m, SIZE_PX) + away_px * outward
            left = int(np.clip(u - width_px / 2, PAD_PX, SIZE_PX - width_px - PAD_PX))
            top = int(np.clip(v - height_px / 2, PAD_PX, SIZE_PX - NAME_SPACING * height_px - PAD_PX))
            areas.append((left, top, np.s_[top : round(top + NAME_SPACING * height_px), left : left + width_px]))
        left, top, pixels = next((area for area in areas if not taken[area[2]].any()), areas[0])
        taken[pixels] = True
        baseline = top + 1.2 * height_px
        draw_text(view, wedge.name, left + 1, baseline + 1, height_px, SHADOW_COLOUR)
        draw_text(view, wedge.name, left, baseline, height_px, colours[wedge.name])
