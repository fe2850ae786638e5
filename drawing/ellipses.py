"""Ellipses around boxes, which point out where results differ."""

import numpy as np
from numpy.typing import NDArray

from ..runtime.geometry import box_corners
from .bird_eye_view import to_view_pixels
from .camera_panel import EDGES, project_segments
from .canvas import Colour, Picture, draw_outline

Array = NDArray[np.float64]

ELLIPSE_COLOUR: Colour = (60, 60, 255)
NUM_POINTS = 72
MARGIN_PX = 7.0
THICKNESS_PX = 2


def draw_ellipses_above(view: Picture, boxes: Array, range_m: float) -> None:
    """Draw an ellipse around each box (M, 9) in a bird's-eye view of x and y in [-range_m, range_m]."""
    outlines = to_view_pixels(box_corners(boxes)[:, :4, :2], range_m, len(view))
    for outline in outlines[np.isfinite(outlines).all(axis=(1, 2))]:
        _draw_ellipse(view, outline)


def draw_ellipses_in_camera(panel: Picture, boxes: Array, panel_T_ego: Array) -> None:
    """Draw an ellipse around the visible part of each box (M, 9) in a camera panel.

    panel_T_ego: (3, 4).
    """
    size_px = (panel.shape[1], panel.shape[0])
    for corners in box_corners(boxes):
        points = project_segments(corners[EDGES], panel_T_ego).reshape(-1, 2)
        is_finite = len(points) > 0 and bool(np.isfinite(points).all())
        if is_finite and (points.max(axis=0) > 0).all() and (points.min(axis=0) < size_px).all():
            _draw_ellipse(panel, np.clip(points, 0, size_px))


def _draw_ellipse(picture: Picture, points: Array) -> None:
    """Draw the ellipse through the corners of the bounding rectangle of points (K, 2) [px], and a margin larger."""
    centre = (points.max(axis=0) + points.min(axis=0)) / 2
    semi_axes = np.sqrt(0.5) * np.ptp(points, axis=0) + MARGIN_PX
    angles = np.linspace(0, 2 * np.pi, NUM_POINTS, endpoint=False)
    outline = centre + semi_axes * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    draw_outline(picture, outline, ELLIPSE_COLOUR, THICKNESS_PX)
