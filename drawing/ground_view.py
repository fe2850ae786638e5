"""The ground view of one camera: its image with a ground grid and the horizon, projected with its calibration.

If the calibration is correct, the lines match the road and the horizon in the image.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera
from ..runtime.geometry import NEAREST_DEPTH_M, project
from .camera_panel import TEXT_COLOUR, draw_name, empty_panel, panel_projection, project_segments
from .canvas import Colour, Picture, draw_outline, draw_segments, draw_text, polygon_edges, text_width_px
from .footer import TEXT_PX, draw_legend_bar, draw_text_bar

Array = NDArray[np.float64]

GRID_COLOUR: Colour = (205, 205, 205)
RING_COLOUR: Colour = (60, 215, 255)
FORWARD_COLOUR: Colour = (70, 70, 255)
LEFT_COLOUR: Colour = (80, 230, 80)
HORIZON_COLOUR: Colour = (255, 170, 60)
CROP_COLOUR: Colour = (255, 90, 255)
SHADOW_COLOUR: Colour = (30, 30, 30)

GRID_STEP_M, GRID_END_M = 10.0, 50.0
RINGS_M = (10.0, 20.0, 30.0, 40.0, 50.0)
NUM_RING_POINTS = 720
# Share of the width. Far rings are close together in the image, so each label is farther to the right than the previous
# one.
LABEL_STEP = 0.09
SIZE_PX = 1280  # of the longer side of the panel
LEAST_SIZE_PX = 160


class GroundLines(NamedTuple):
    """Lines of one kind on the ground, their name in the legend and their style.

    segments: (S, 2, 3) [m] in the ego frame.
    """

    name: str
    segments: Array
    colour: Colour
    thickness_px: int


def draw_ground_view(
    name: str,
    camera: Camera,
    image: NDArray[np.uint8] | None,
    notes: list[tuple[str, Colour]],
    crop: Array | None = None,
) -> Picture:
    """Draw the ground (z = 0 of the ego frame) and the horizon over an image. Below it are a legend and notes.

    image: (height, width, 3) uint8 BGR of any size, or None for a lost camera.
    notes: texts and their colours.
    crop: (4, 2) corners [px] of the part of the image that is the network's input.
    """
    size_px = panel_size(camera)
    panel = empty_panel(image, size_px, 1.0)
    with np.errstate(all="ignore"):
        _draw_ground(panel, panel_projection(camera, size_px))
    colours = {line.name: line.colour for line in ground_lines()} | {"horizon": HORIZON_COLOUR}
    if crop is not None:
        draw_outline(panel, crop * (size_px[0] / camera.width_px, size_px[1] / camera.height_px), CROP_COLOUR, 3)
        colours["network input"] = CROP_COLOUR
    draw_name(panel, name, 1.4)
    return np.concatenate([panel, draw_legend_bar(colours, size_px[0]), draw_text_bar(notes, size_px[0])])


def panel_size(camera: Camera) -> tuple[int, int]:
    """Width and height of the panel [px]. It has the aspect ratio of the image, unless that is extreme."""
    scale = SIZE_PX / max(camera.width_px, camera.height_px)
    return max(LEAST_SIZE_PX, round(camera.width_px * scale)), max(LEAST_SIZE_PX, round(camera.height_px * scale))


def ground_lines() -> list[GroundLines]:
    """The lines on the ground, in drawing order."""
    steps = np.arange(-GRID_END_M, GRID_END_M + 1, GRID_STEP_M)
    ends = np.array([-GRID_END_M, GRID_END_M])
    across = np.stack(np.broadcast_arrays(steps[:, None], ends, 0.0), axis=-1)
    origin = np.zeros(3)
    return [
        GroundLines("grid of 10 m", np.concatenate([across, across[..., [1, 0, 2]]]), GRID_COLOUR, 2),
        GroundLines(
            "10 to 50 m from the ego",
            np.concatenate([polygon_edges(ring_points(radius_m)) for radius_m in RINGS_M]),
            RING_COLOUR,
            2,
        ),
        GroundLines("forward (x)", np.array([[origin, (GRID_END_M, 0, 0)]]), FORWARD_COLOUR, 3),
        GroundLines("left (y)", np.array([[origin, (0, GRID_END_M, 0)]]), LEFT_COLOUR, 3),
    ]


def ring_points(radius_m: float) -> Array:
    """Points (K, 3) [m] of a circle on the ground around the ego."""
    angles = np.linspace(0, 2 * np.pi, NUM_RING_POINTS, endpoint=False)
    return radius_m * np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1)


def horizon_segments(panel_T_ego: Array) -> Array:
    """The horizon (S, 2, 2) [px]: the vanishing points of all directions in the ground plane."""
    directions = polygon_edges(ring_points(1.0))
    # A point at infinity has no translation, so the last column of the projection is zero.
    return project_segments(directions, np.column_stack([panel_T_ego[:, :3], np.zeros(3)]))


def _draw_ground(panel: Picture, panel_T_ego: Array) -> None:
    for line in ground_lines():
        _draw_with_rim(panel, project_segments(line.segments, panel_T_ego), line.colour, line.thickness_px)
    _draw_with_rim(panel, horizon_segments(panel_T_ego), HORIZON_COLOUR, 2)
    taken = np.zeros(panel.shape[:2], dtype=bool)
    for number, radius_m in enumerate(RINGS_M):
        target_px = panel.shape[1] * (0.5 + LABEL_STEP * (number - len(RINGS_M) // 2))
        _label_ring(panel, panel_T_ego, radius_m, target_px, taken)


def _draw_with_rim(panel: Picture, segments: Array, colour: Colour, thickness_px: int) -> None:
    """Draw lines with a dark rim, so that they are visible on any image."""
    draw_segments(panel, segments, SHADOW_COLOUR, thickness_px + 2)
    draw_segments(panel, segments, colour, thickness_px)


def _label_ring(
    panel: Picture, panel_T_ego: Array, radius_m: float, target_px: float, taken: NDArray[np.bool_]
) -> None:
    """Write the radius of a ring on it, at the free place nearest to the column `target_px`.

    taken: (H, W) pixels covered by labels; changed in place.
    """
    text = f"{radius_m:.0f} m"
    width_px = text_width_px(text, TEXT_PX)
    pixels, depth_m = project(ring_points(radius_m), panel_T_ego)
    size_px = np.array([width_px, 1.2 * TEXT_PX])
    corners = pixels - size_px / 2
    is_inside = (corners >= 2) & (corners + size_px <= (panel.shape[1] - 2, panel.shape[0] - 2))
    places = corners[is_inside.all(axis=1) & (depth_m > NEAREST_DEPTH_M)]
    order = np.argsort(np.abs(places[:, 0] + width_px / 2 - target_px), kind="stable")
    for left, top in places[order].round().astype(int):
        area = np.s_[top : top + round(1.2 * TEXT_PX), left : left + width_px]
        if not taken[area].any():
            taken[area] = True
            _write_with_rim(panel, text, left, top + TEXT_PX)
            return


def _write_with_rim(panel: Picture, text: str, left_px: float, baseline_px: float) -> None:
    """Write a text with a dark rim, so that it is readable on any image."""
    for right, down in product((-1, 0, 1), repeat=2):
        draw_text(panel, text, left_px + right, baseline_px + down, TEXT_PX, SHADOW_COLOUR)
    draw_text(panel, text, left_px, baseline_px, TEXT_PX, TEXT_COLOUR)
