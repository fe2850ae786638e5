"""The panel of one camera: its image with boxes projected into it."""

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

# Pairs of rows of `box_corners`: the edges of the bottom, those of the top, and the vertical ones.
EDGES = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)])
FRONT_FACE = np.array([0, 1, 5, 4])

FRONT_OPACITY = 0.35
LARGE_BOX_PX = 50  # boxes that are lower than this have thin lines
LABEL_HEIGHT_PX = 12
LOST_COLOUR: Colour = (26, 23, 22)
TEXT_COLOUR: Colour = (235, 235, 235)
SHADE_COLOUR: Colour = (24, 20, 18)


def draw_camera(
    name: str,
    camera: Camera,
    image: NDArray[np.uint8] | None,
    box_groups: list[StyledBoxes],
    size_px: tuple[int, int],
    scale: float,
) -> Picture:
    """Draw the panel of one camera.

    name: written into the upper left corner.
    image: (height, width, 3) uint8 BGR, or None for a lost camera. Its panel is dark and reads "lost".
    box_groups: boxes in the ego frame. Groups are drawn in this order, boxes of a group from far to near. The front
        face is tinted if the group is solid. A line from the centre of the bottom to the front shows the heading.
    size_px: (width, height) of the panel.
    scale: of texts and lines.
    """
    panel = empty_panel(image, size_px, scale)
    if image is not None:
        panel_T_ego = panel_projection(camera, size_px)
        for boxes in box_groups:
            _draw_boxes(panel, boxes, panel_T_ego, scale)
    draw_name(panel, name, scale)
    return panel


def empty_panel(image: NDArray[np.uint8] | None, size_px: tuple[int, int], scale: float) -> Picture:
    """The image of a camera, resized to `size_px`. For a lost camera, a dark panel that reads "lost"."""
    if image is None:
        panel = blank(*size_px, LOST_COLOUR)
        draw_text(panel, "lost", *_centred("lost", size_px, 26 * scale), 26 * scale, (120, 120, 130))
        return panel
    kernel = cv2.INTER_AREA if size_px[0] < image.shape[1] else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size_px, interpolation=kernel), dtype=np.uint8)


def draw_name(panel: Picture, name: str, scale: float) -> None:
    """Write the name of a camera into the upper left corner of its panel. A long name is written smaller."""
    pad_px = 5 * scale
    height_px = fitting_height_px(name, 13 * scale, panel.shape[1] - 2 * pad_px)
    right, bottom = round(text_width_px(name, height_px) + 2 * pad_px), round(height_px + 1.4 * pad_px)
    corner = panel[:bottom, :right]
    blend(corner, blank(corner.shape[1], corner.shape[0], SHADE_COLOUR), 0.6)
    draw_text(panel, name, pad_px, height_px + 0.3 * pad_px, height_px, TEXT_COLOUR)


def panel_projection(camera: Camera, size_px: tuple[int, int]) -> Array:
    """The projection (3, 4) from the ego frame to the pixels of the image resized to `size_px`."""
    resize = np.diag([size_px[0] / camera.width_px, size_px[1] / camera.height_px, 1.0])
    return resize @ image_T_ego(camera.intrinsics_px, camera.camera_T_ego)


def project_segments(segments: Array, image_T_frame: Array) -> Array:
    """Project lines (S, 2, 3) [m] to pixels (<=S, 2, 2), after clipping them at a depth of `NEAREST_DEPTH_M`.

    image_T_frame: (3, 4).
    """
    return _pixels(clip_segments(_homogeneous(segments, image_T_frame), (0, 0, 1), NEAREST_DEPTH_M))


def project_polygon(polygon: Array, image_T_frame: Array) -> Array:
    """Project a convex polygon (K, 3) [m] to pixels (<=K + 1, 2), after clipping it at a depth of `NEAREST_DEPTH_M`.

    image_T_frame: (3, 4).
    """
    return _pixels(clip_polygon(_homogeneous(polygon, image_T_frame), (0, 0, 1), NEAREST_DEPTH_M))


def _draw_boxes(panel: Picture, styled: StyledBoxes, panel_T_ego: Array, scale: float) -> None:
    corners = box_corners(styled.boxes)
    order = _far_to_near(corners, panel_T_ego, (panel.shape[1], panel.shape[0]))
    if styled.solid:
        layer = panel.copy()
        for box in order:
            draw_face(layer, project_polygon(corners[box, FRONT_FACE], panel_T_ego), styled.colours[box])
        blend(panel, layer, FRONT_OPACITY)
    lines = {box: project_segments(_wireframe(corners[box]), panel_T_ego) for box in order}
    for box in order:
        is_large = np.ptp(lines[box][..., 1]) > LARGE_BOX_PX * scale
        draw_segments(panel, lines[box], styled.colours[box], styled.thickness_px if is_large else styled.thin_px)
    _write_labels(panel, styled, lines, LABEL_HEIGHT_PX * scale)


def _far_to_near(corners: Array, panel_T_ego: Array, size_px: tuple[int, int]) -> list[int]:
    """Indices of the boxes that may be visible in the panel, from far to near.

    Boxes behind the camera, boxes outside of the image and boxes that are not finite are left out. A box that crosses
    the plane of the camera is kept: its projected corners do not tell whether it is outside of the image.
    """
    pixels, depth_m = project(corners, panel_T_ego)
    in_front = depth_m > NEAREST_DEPTH_M
    is_inside = ((pixels.max(axis=1) > 0) & (pixels.min(axis=1) < size_px)).all(axis=1)
    is_finite = np.isfinite(pixels).all(axis=(1, 2))
    may_be_visible = is_finite & in_front.any(axis=1) & (is_inside | ~in_front.all(axis=1))
    order = np.argsort(-depth_m.mean(axis=1), kind="stable")
    return order[may_be_visible[order]].tolist()


def _wireframe(corners: Array) -> Array:
    """The lines (13, 2, 3) [m] of a box: its edges, and a line from the centre of its bottom to the front."""
    heading = np.stack([corners[:4].mean(axis=0), corners[:2].mean(axis=0)])
    return np.concatenate([corners[EDGES], heading[None]])


def _write_labels(panel: Picture, styled: StyledBoxes, lines: dict[int, Array], height_px: float) -> None:
    """Write the labels above the boxes, from near to far.

    Labels of small boxes, and labels that would overlap another one, are left out.

    lines: lines in pixels by box, from far to near.
    """
    taken = np.zeros(panel.shape[:2], dtype=bool)
    for box, box_lines in reversed(lines.items()):
        label = styled.labels[box]
        points = box_lines.reshape(-1, 2)
        left, top = points.min(axis=0)
        width_px = text_width_px(label, height_px)
        is_inside = 0 <= left <= panel.shape[1] - width_px and 1.2 * height_px < top < panel.shape[0]
        if not label or not is_inside or np.ptp(points[:, 1]) < 2 * height_px:
            continue
        area = np.s_[round(top - 1.2 * height_px) : round(top), round(left) : round(left + width_px) + 1]
        if not taken[area].any():
            taken[area] = True
            draw_text(panel, label, left, top - 0.35 * height_px, height_px, styled.colours[box])


def _centred(text: str, size_px: tuple[int, int], height_px: float) -> tuple[float, float]:
    return (size_px[0] - text_width_px(text, height_px)) / 2, (size_px[1] + 0.7 * height_px) / 2


def _homogeneous(points: Array, image_T_frame: Array) -> Array:
    return points @ image_T_frame[:, :3].T + image_T_frame[:, 3]


def _pixels(homogeneous: Array) -> Array:
    return homogeneous[..., :2] / homogeneous[..., 2:]
