"""What one camera sees, with the boxes projected into it."""

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera
from ..runtime.geometry import NEAREST_DEPTH_M, box_corners, image_T_ego, project
from .box_style import StyledBoxes
from .canvas import (
    Colour,
    Picture,
    blank,
    blend,
    clip_polygon,
    clip_segments,
    draw_face,
    draw_segments,
    draw_text,
    fitting_height_px,
    text_width_px,
)

Array = NDArray[np.float64]

# Rows into `box_corners`: the bottom, the top, the posts.
EDGES = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)])
FRONT_FACE = np.array([0, 1, 5, 4])

FRONT_OPACITY = 0.35
LARGE_BOX_PX = 50  # lower boxes are drawn in thin lines
LABEL_HEIGHT_PX = 12
LOST_COLOUR: Colour = (26, 23, 22)
TEXT_COLOUR: Colour = (235, 235, 235)
SHADE_COLOUR: Colour = (24, 20, 18)


def draw_camera(
    name: str,
    camera: Camera,
    image: NDArray[np.uint8] | None,
    marks: list[StyledBoxes],
    size_px: tuple[int, int],
    scale: float,
) -> Picture:
    """One camera's panel.

    image: (height, width, 3) uint8 BGR, or None for a lost camera, whose panel says so.
    marks: boxes in the ego frame, drawn in this order, the far ones of each first. The front face of solid
        ones is tinted; a line on the ground leads from the middle of every box to its front.
    size_px: (width, height) of the panel. scale: of words and lines.
    """
    panel = empty_panel(image, size_px, scale)
    if image is not None:
        panel_T_ego = panel_projection(camera, size_px)
        for group in marks:
            _draw_boxes(panel, group, panel_T_ego, scale)
    draw_name(panel, name, scale)
    return panel


def empty_panel(image: NDArray[np.uint8] | None, size_px: tuple[int, int], scale: float) -> Picture:
    """A camera's panel with nothing drawn over its picture; for a lost camera it says so."""
    if image is None:
        panel = blank(*size_px, LOST_COLOUR)
        draw_text(panel, "lost", *_centered("lost", size_px, 26 * scale), 26 * scale, (120, 120, 130))
        return panel
    kernel = cv2.INTER_AREA if size_px[0] < image.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size_px, interpolation=kernel), dtype=np.uint8)


def draw_name(panel: Picture, name: str, scale: float) -> None:
    """Write a camera's name into the upper left corner of its panel, smaller where it is long."""
    pad_px = 5 * scale
    height_px = fitting_height_px(name, 13 * scale, panel.shape[1] - 2 * pad_px)
    right, bottom = round(text_width_px(name, height_px) + 2 * pad_px), round(height_px + 1.4 * pad_px)
    chip = panel[:bottom, :right]
    blend(chip, blank(chip.shape[1], chip.shape[0], SHADE_COLOUR), 0.6)
    draw_text(panel, name, pad_px, height_px + 0.3 * pad_px, height_px, TEXT_COLOUR)


def panel_projection(camera: Camera, size_px: tuple[int, int]) -> Array:
    """The projection (3, 4) from the ego frame to the pixels of the image resized to `size_px`."""
    resize = np.diag([size_px[0] / camera.width_px, size_px[1] / camera.height_px, 1.0])
    return resize @ image_T_ego(camera.intrinsics_px, camera.camera_T_ego)


def project_segments(segments: Array, image_T_frame: Array) -> Array:
    """Project lines (S, 2, 3) to pixels (<=S, 2, 2), without what is nearer than `NEAREST_DEPTH_M`."""
    return _pixels(clip_segments(_homogeneous(segments, image_T_frame), (0, 0, 1), NEAREST_DEPTH_M))


def project_polygon(polygon: Array, image_T_frame: Array) -> Array:
    """Project a convex polygon (K, 3) to pixels (<=K + 1, 2), without what is nearer than that."""
    return _pixels(clip_polygon(_homogeneous(polygon, image_T_frame), (0, 0, 1), NEAREST_DEPTH_M))


def _draw_boxes(panel: Picture, marks: StyledBoxes, panel_T_ego: Array, scale: float) -> None:
    corners = box_corners(marks.boxes)
    order = _far_to_near(corners, panel_T_ego, (panel.shape[1], panel.shape[0]))
    if marks.solid:
        layer = panel.copy()
        for box in order:
            draw_face(layer, project_polygon(corners[box, FRONT_FACE], panel_T_ego), marks.colours[box])
        blend(panel, layer, FRONT_OPACITY)
    lines = {box: project_segments(_wireframe(corners[box]), panel_T_ego) for box in order}
    for box in order:
        large = np.ptp(lines[box][..., 1]) > LARGE_BOX_PX * scale
        draw_segments(panel, lines[box], marks.colours[box], marks.thickness_px if large else marks.thin_px)
    _write_labels(panel, marks, lines, LABEL_HEIGHT_PX * scale)


def _far_to_near(corners: Array, panel_T_ego: Array, size_px: tuple[int, int]) -> list[int]:
    """The boxes that the panel may show, the farthest first.

    Left out are those behind the camera, those before it that lie beside the picture, and what is not finite.
    """
    pixels, depth_m = project(corners, panel_T_ego)
    in_front = depth_m > NEAREST_DEPTH_M
    inside = ((pixels.max(axis=1) > 0) & (pixels.min(axis=1) < size_px)).all(axis=1)
    finite = np.isfinite(pixels).all(axis=(1, 2))
    shown = finite & in_front.any(axis=1) & (inside | ~in_front.all(axis=1))
    order = np.argsort(-depth_m.mean(axis=1), kind="stable")
    return order[shown[order]].tolist()


def _wireframe(corners: Array) -> Array:
    """The lines (13, 2, 3) of a box: its edges, and on its bottom one from the middle to the front."""
    heading = np.stack([corners[:4].mean(axis=0), corners[:2].mean(axis=0)])
    return np.concatenate([corners[EDGES], heading[None]])


def _write_labels(panel: Picture, marks: StyledBoxes, lines: dict[int, Array], height_px: float) -> None:
    """Write labels over the boxes that are not small, the nearest first, none over another.

    lines: by box, the farthest first, as they are drawn.
    """
    taken = np.zeros(panel.shape[:2], dtype=bool)
    for box, box_lines in reversed(lines.items()):
        label = marks.labels[box]
        points = box_lines.reshape(-1, 2)
        left, top = points.min(axis=0)
        width_px = text_width_px(label, height_px)
        inside = 0 <= left <= panel.shape[1] - width_px and 1.2 * height_px < top < panel.shape[0]
        if not label or not inside or np.ptp(points[:, 1]) < 2 * height_px:
            continue
        place = np.s_[round(top - 1.2 * height_px) : round(top), round(left) : round(left + width_px) + 1]
        if not taken[place].any():
            taken[place] = True
            draw_text(panel, label, left, top - 0.35 * height_px, height_px, marks.colours[box])


def _centered(text: str, size_px: tuple[int, int], height_px: float) -> tuple[float, float]:
    return (size_px[0] - text_width_px(text, height_px)) / 2, (size_px[1] + 0.7 * height_px) / 2


def _homogeneous(points: Array, image_T_frame: Array) -> Array:
    return points @ image_T_frame[:, :3].T + image_T_frame[:, 3]


def _pixels(homogeneous: Array) -> Array:
    return homogeneous[..., :2] / homogeneous[..., 2:]
