"""The bird's-eye view: boxes and maps seen from above. Forward is up, left is left."""

from collections.abc import Mapping

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..runtime.geometry import box_corners
from .box_style import StyledBoxes, line_px
from .canvas import Colour, Picture, blank, blend, draw_circle, draw_face, draw_outline, draw_segments, draw_text

Array = NDArray[np.float64]

GROUND_COLOUR: Colour = (34, 28, 25)
RING_COLOUR: Colour = (112, 100, 92)
RING_TEXT_COLOUR: Colour = (150, 138, 130)
EGO_COLOUR: Colour = (240, 240, 240)
MAP_COLOURS: dict[str, Colour] = {"drivable_area": (122, 98, 82), "lane_boundary": (150, 190, 215)}
OTHER_MAP_COLOUR: Colour = (140, 110, 130)

FACE_OPACITY = 0.45
RING_STEP_M = 10.0
SLOWEST_ARROW_M_S = 0.3  # slower boxes have no arrow
ARROW_S = 1.0  # the length of an arrow is the distance covered in this time
# The outline of a car, x forward and y left. The origin of the ego frame is at its rear axle.
EGO_OUTLINE_M = np.array([(3.2, 0.45), (3.2, -0.45), (2.6, -0.9), (-0.9, -0.9), (-0.9, 0.9), (2.6, 0.9)])
EGO_HEADING_M = np.array([(2.6, 0.0), (1.2, 0.6), (1.2, -0.6)])


def draw_bird_eye_view(
    box_groups: list[StyledBoxes], maps: Mapping[str, ArrayLike], range_m: float, size_px: int, scale: float
) -> Picture:
    """Draw the bird's-eye view (size_px, size_px, 3) of x and y in [-range_m, range_m].

    box_groups: boxes in the ego frame, drawn in this order. An arrow shows the motion of a box in one second.
    maps: by name, (X, Y) probabilities or bool over the same range. Cell [i, j] is at x_i (forward) and y_j (left).
    scale: of texts and lines.
    """
    view = blank(size_px, size_px, GROUND_COLOUR)
    for name, mask in maps.items():
        view = _tint(view, np.asarray(mask, dtype=np.float32), MAP_COLOURS.get(name, OTHER_MAP_COLOUR))
    draw_rings(view, range_m, scale)
    draw_ego(view, range_m, scale)
    for boxes in box_groups:
        _draw_boxes(view, boxes, range_m)
    return view


def to_view_pixels(points_m: ArrayLike, range_m: float, size_px: int) -> Array:
    """Map points (..., 2) [m], x forward and y left, to pixels (..., 2) of the view."""
    points_m = np.asarray(points_m, dtype=np.float64)
    return (range_m - points_m[..., ::-1]) * size_px / (2 * range_m)


def _tint(view: Picture, mask: NDArray[np.float32], colour: Colour) -> Picture:
    """Blend a colour over the view, with the probability of each cell as its opacity."""
    size = view.shape[1], view.shape[0]
    # The first row of the view is the farthest ahead and its first column the farthest left, so both axes are flipped.
    opacity = cv2.resize(np.ascontiguousarray(mask[::-1, ::-1]), size, interpolation=cv2.INTER_NEAREST)
    opacity = np.clip(np.nan_to_num(opacity), 0, 1)
    tinted = cv2.blendLinear(view, blank(*size, colour), 1 - opacity, opacity)
    return np.asarray(tinted, dtype=np.uint8)


def draw_rings(view: Picture, range_m: float, scale: float) -> None:
    """Draw a circle around the ego every ten metres, labelled with its radius."""
    size_px = len(view)
    middle = size_px / 2
    height_px = 11 * scale
    for radius_m in np.arange(RING_STEP_M, range_m, RING_STEP_M):
        radius_px = radius_m * size_px / (2 * range_m)
        draw_circle(view, (middle, middle), radius_px, RING_COLOUR, line_px(scale))
        label = f"{radius_m:.0f} m"
        diagonal = middle + radius_px / np.sqrt(2)
        draw_text(view, label, diagonal + 2 * scale, diagonal + height_px, height_px, RING_TEXT_COLOUR)


def draw_ego(view: Picture, range_m: float, scale: float) -> None:
    """Draw the outline of a car at the ego, with its direction."""
    draw_outline(view, to_view_pixels(EGO_OUTLINE_M, range_m, len(view)), EGO_COLOUR, line_px(scale))
    draw_face(view, to_view_pixels(EGO_HEADING_M, range_m, len(view)), EGO_COLOUR)


def _draw_boxes(view: Picture, styled: StyledBoxes, range_m: float) -> None:
    outlines = to_view_pixels(box_corners(styled.boxes)[:, :4, :2], range_m, len(view))
    if styled.solid:
        layer = view.copy()
        for outline, colour in zip(outlines, styled.colours, strict=True):
            draw_face(layer, outline, colour)
        blend(view, layer, FACE_OPACITY)
    for box, outline, colour in zip(styled.boxes, outlines, styled.colours, strict=True):
        draw_outline(view, outline, colour, styled.thin_px)
        heading = np.stack([outline.mean(axis=0), outline[:2].mean(axis=0)])
        draw_segments(view, heading, colour, styled.thin_px)
        draw_segments(view, to_view_pixels(_velocity_arrow(box), range_m, len(view)), colour, styled.thin_px)


def _velocity_arrow(box: Array) -> Array:
    """The lines (3, 2, 2) [m] of the velocity arrow; (0, 2, 2) for a slow box or an unknown velocity."""
    start, step = box[:2], box[7:9] * ARROW_S
    length = np.hypot(*step)
    if length < SLOWEST_ARROW_M_S * ARROW_S:
        return np.empty((0, 2, 2))
    end = start + step
    barb = step / length * min(1.2, 0.4 * length)
    across = np.array([-barb[1], barb[0]]) * 0.5
    return np.array([(start, end), (end, end - barb + across), (end, end - barb - across)])
