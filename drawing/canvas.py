"""Lines, faces and texts on a BGR picture, with subpixel positions.

Positions are image coordinates (u right, v down). The centre of the first pixel is (0.5, 0.5). In OpenCV it is (0, 0),
so 0.5 is subtracted before OpenCV is called.

OpenCV takes positions as 32-bit integers, which overflow for far points. Therefore shapes are clipped to the picture
before they are drawn. Shapes with NaN or infinite coordinates are skipped.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Picture = NDArray[np.uint8]
Array = NDArray[np.float64]
Colour = tuple[int, int, int]  # BGR

FRACTION_BITS = 4  # OpenCV takes positions in sixteenths of a pixel
MARGIN_PX = 16.0  # shapes are clipped this far outside, where the new ends and edges are not visible
FONT = cv2.FONT_HERSHEY_SIMPLEX
FONT_HEIGHT_PX = 27.0  # at scale 1


def blank(width_px: int, height_px: int, colour: Colour) -> Picture:
    """Create a picture (height_px, width_px, 3) of one colour."""
    picture = np.empty((height_px, width_px, 3), dtype=np.uint8)
    cv2.rectangle(picture, (0, 0), (width_px, height_px), colour, cv2.FILLED)
    return picture


def draw_segments(picture: Picture, segments: ArrayLike, colour: Colour, thickness_px: int = 1) -> None:
    """Draw straight lines (S, 2, 2) [px] from [:, 0] to [:, 1]."""
    segments = np.asarray(segments, dtype=np.float64).reshape(-1, 2, 2)
    if not _contains(picture, segments):
        for normal, offset in _borders(picture):
            segments = clip_segments(segments, normal, offset)
    if len(segments):
        lines = list(_to_opencv(segments))
        cv2.polylines(picture, lines, False, colour, thickness_px, cv2.LINE_AA, FRACTION_BITS)


def draw_outline(picture: Picture, polygon: ArrayLike, colour: Colour, thickness_px: int = 1) -> None:
    """Draw the closed outline of a polygon (K, 2) [px]."""
    draw_segments(picture, polygon_edges(np.asarray(polygon, dtype=np.float64)), colour, thickness_px)


def draw_face(picture: Picture, polygon: ArrayLike, colour: Colour) -> None:
    """Fill a convex polygon (K, 2) [px]."""
    polygon = np.asarray(polygon, dtype=np.float64)
    if not _contains(picture, polygon):
        for normal, offset in _borders(picture):
            polygon = clip_polygon(polygon, normal, offset)
    if len(polygon) > 2:
        cv2.fillConvexPoly(picture, _to_opencv(polygon), colour, cv2.LINE_AA, FRACTION_BITS)


def draw_circle(
    picture: Picture, centre: tuple[float, float], radius_px: float, colour: Colour, thickness_px: int = 1
) -> None:
    """Draw a circle. It is not clipped, so its radius may be only a few times the size of the picture."""
    u, v = _to_opencv(np.array(centre))
    radius = round(radius_px * 2**FRACTION_BITS)
    cv2.circle(picture, (int(u), int(v)), radius, colour, thickness_px, cv2.LINE_AA, FRACTION_BITS)


def draw_text(
    picture: Picture, text: str, left_px: float, baseline_px: float, height_px: float, colour: Colour
) -> None:
    """Write one line of text, given its left end, its baseline and the height of its capital letters."""
    origin = (round(left_px), round(baseline_px))
    cv2.putText(picture, text, origin, FONT, height_px / FONT_HEIGHT_PX, colour, 1, cv2.LINE_AA)


def text_width_px(text: str, height_px: float) -> int:
    """The width of a text written by `draw_text`."""
    return int(cv2.getTextSize(text, FONT, height_px / FONT_HEIGHT_PX, 1)[0][0])


def fitting_height_px(text: str, height_px: float, room_px: float) -> float:
    """The largest text height, at most `height_px`, for which a text is no wider than `room_px`."""
    width_px = text_width_px(text, height_px)
    return height_px if width_px <= room_px else height_px * max(room_px, 1.0) / (width_px + 1)


def wrap_text(text: str, height_px: float, room_px: float) -> list[str]:
    """Break a text into lines no wider than `room_px`. Words are broken only if they are too long for one line."""
    lines = [""]
    for word in text.split():
        longer = f"{lines[-1]} {word}".strip()
        if text_width_px(longer, height_px) <= room_px:
            lines[-1] = longer
            continue
        lines += [""] if lines[-1] else []
        for letter in word:
            if lines[-1] and text_width_px(lines[-1] + letter, height_px) > room_px:
                lines.append("")
            lines[-1] += letter
    return lines


def blend(picture: Picture, layer: Picture, opacity: float) -> None:
    """Blend a layer of the same size into a picture, in place."""
    cv2.addWeighted(layer, opacity, picture, 1.0 - opacity, 0.0, dst=picture)


def polygon_edges(polygon: Array) -> Array:
    """The edges (K, 2, 2) of a closed polygon (K, 2)."""
    return np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1)


def clip_segments(segments: Array, normal: ArrayLike, offset: float) -> Array:
    """Clip lines (S, 2, C) to the side `normal @ point >= offset`; the result is (<=S, 2, C)."""
    with np.errstate(invalid="ignore", over="ignore"):
        distance = segments @ np.asarray(normal, dtype=np.float64) - offset
        kept = np.isfinite(distance).all(axis=1) & (distance >= 0).any(axis=1)
    segments, distance = segments[kept].copy(), distance[kept]
    rows, outside = np.nonzero(distance < 0)  # `outside` is the end, 0 or 1, on the other side
    share = distance[rows, outside] / (distance[rows, outside] - distance[rows, 1 - outside])
    toward = segments[rows, 1 - outside] - segments[rows, outside]
    segments[rows, outside] += share[:, None] * toward
    return segments


def clip_polygon(polygon: Array, normal: ArrayLike, offset: float) -> Array:
    """Clip a convex polygon (K, C) to the side `normal @ point >= offset`; the result is (<=K + 1, C).

    Each edge is clipped, and the ends of all edges are joined in order, each point once (Sutherland and Hodgman, 1974).
    """
    ends = clip_segments(polygon_edges(polygon), normal, offset).reshape(-1, polygon.shape[-1])
    return ends[(ends != np.roll(ends, 1, axis=0)).any(axis=1)]


def _borders(picture: Picture) -> Sequence[tuple[tuple[float, float], float]]:
    """Normal and offset of the four sides of a picture, with a margin, for `clip_segments`."""
    height, width = picture.shape[:2]
    return (
        ((1.0, 0.0), -MARGIN_PX),
        ((-1.0, 0.0), -width - MARGIN_PX),
        ((0.0, 1.0), -MARGIN_PX),
        ((0.0, -1.0), -height - MARGIN_PX),
    )


def _contains(picture: Picture, points: Array) -> bool:
    height, width = picture.shape[:2]
    return bool((points >= -MARGIN_PX).all() and (points <= (width + MARGIN_PX, height + MARGIN_PX)).all())


def _to_opencv(points: Array) -> NDArray[np.int32]:
    return np.rint((points - 0.5) * 2**FRACTION_BITS).astype(np.int32)
