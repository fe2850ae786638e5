"""Lines, faces and words on a BGR picture, placed to a fraction of a pixel.

Positions are image coordinates (u right, v down), the first pixel's centre at (0.5, 0.5). OpenCV puts that
centre at (0, 0), so half a pixel is taken off on the way. It also counts in 32-bit integers, which far points
overflow: everything is clipped to the picture before it is drawn, and what is not finite is left out.
"""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Picture = NDArray[np.uint8]
Array = NDArray[np.float64]
Colour = tuple[int, int, int]  # BGR

FRACTION_BITS = 4  # OpenCV takes positions in sixteenths of a pixel
MARGIN_PX = 16.0  # a line's end this far outside shows neither its cap nor its cut
FONT = cv2.FONT_HERSHEY_SIMPLEX
FONT_HEIGHT_PX = 27.0  # at scale 1


def blank(width_px: int, height_px: int, colour: Colour) -> Picture:
    """A picture (height_px, width_px, 3) of one colour."""
    picture = np.empty((height_px, width_px, 3), dtype=np.uint8)
    cv2.rectangle(picture, (0, 0), (width_px, height_px), colour, cv2.FILLED)
    return picture


def draw_segments(picture: Picture, segments: ArrayLike, colour: Colour, thickness_px: int = 1) -> None:
    """Draw straight lines (S, 2, 2) from [:, 0] to [:, 1]."""
    segments = np.asarray(segments, dtype=np.float64).reshape(-1, 2, 2)
    if not _holds(picture, segments):
        for normal, offset in _borders(picture):
            segments = clip_segments(segments, normal, offset)
    if len(segments):
        lines = list(_to_opencv(segments))
        cv2.polylines(picture, lines, False, colour, thickness_px, cv2.LINE_AA, FRACTION_BITS)


def draw_outline(picture: Picture, polygon: ArrayLike, colour: Colour, thickness_px: int = 1) -> None:
    """Draw the closed outline of a polygon (K, 2)."""
    draw_segments(picture, outline(np.asarray(polygon, dtype=np.float64)), colour, thickness_px)


def draw_face(picture: Picture, polygon: ArrayLike, colour: Colour) -> None:
    """Fill a convex polygon (K, 2)."""
    polygon = np.asarray(polygon, dtype=np.float64)
    if not _holds(picture, polygon):
        for normal, offset in _borders(picture):
            polygon = clip_polygon(polygon, normal, offset)
    if len(polygon) > 2:
        cv2.fillConvexPoly(picture, _to_opencv(polygon), colour, cv2.LINE_AA, FRACTION_BITS)


def draw_circle(
    picture: Picture, center: tuple[float, float], radius_px: float, colour: Colour, thickness_px: int = 1
) -> None:
    """Draw a circle that is not larger than a few pictures."""
    u, v = _to_opencv(np.array(center))
    radius = round(radius_px * 2**FRACTION_BITS)
    cv2.circle(picture, (int(u), int(v)), radius, colour, thickness_px, cv2.LINE_AA, FRACTION_BITS)


def draw_text(
    picture: Picture, text: str, left_px: float, baseline_px: float, height_px: float, colour: Colour
) -> None:
    """Write one line of text from its left end, standing on its baseline."""
    origin = (round(left_px), round(baseline_px))
    cv2.putText(picture, text, origin, FONT, height_px / FONT_HEIGHT_PX, colour, 1, cv2.LINE_AA)


def text_width_px(text: str, height_px: float) -> int:
    """How wide `draw_text` writes a text."""
    return int(cv2.getTextSize(text, FONT, height_px / FONT_HEIGHT_PX, 1)[0][0])


def fitting_height_px(text: str, height_px: float, room_px: float) -> float:
    """The height, at most `height_px`, at which a text is no wider than `room_px`."""
    width_px = text_width_px(text, height_px)
    return height_px if width_px <= room_px else height_px * max(room_px, 1.0) / (width_px + 1)


def wrap_text(text: str, height_px: float, room_px: float) -> list[str]:
    """Break a text into lines that are no wider than `room_px`, between words or, where one is too long, in it."""
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
    """Lay a picture of the same size over another, in place; where they agree, nothing changes."""
    cv2.addWeighted(layer, opacity, picture, 1.0 - opacity, 0.0, dst=picture)


def outline(polygon: Array) -> Array:
    """The edges (K, 2, 2) of a closed polygon (K, 2)."""
    return np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1)


def clip_segments(segments: Array, normal: ArrayLike, offset: float) -> Array:
    """Keep what of segments (S, 2, C) lies where `normal @ point >= offset`: (<=S, 2, C)."""
    with np.errstate(invalid="ignore", over="ignore"):
        above = segments @ np.asarray(normal, dtype=np.float64) - offset
        kept = np.isfinite(above).all(axis=1) & (above >= 0).any(axis=1)
    segments, above = segments[kept].copy(), above[kept]
    rows, outside = np.nonzero(above < 0)
    share = above[rows, outside] / (above[rows, outside] - above[rows, 1 - outside])
    toward = segments[rows, 1 - outside] - segments[rows, outside]
    segments[rows, outside] += share[:, None] * toward
    return segments


def clip_polygon(polygon: Array, normal: ArrayLike, offset: float) -> Array:
    """Keep what of a convex polygon (K, C) lies where `normal @ point >= offset`; (0, C) where nothing does.

    Sutherland-Hodgman: the ends of what is kept of each edge, in order, and each point once.
    """
    ends = clip_segments(outline(polygon), normal, offset).reshape(-1, polygon.shape[-1])
    return ends[(ends != np.roll(ends, 1, axis=0)).any(axis=1)]


def _borders(picture: Picture) -> Sequence[tuple[tuple[float, float], float]]:
    height, width = picture.shape[:2]
    return (
        ((1.0, 0.0), -MARGIN_PX),
        ((-1.0, 0.0), -width - MARGIN_PX),
        ((0.0, 1.0), -MARGIN_PX),
        ((0.0, -1.0), -height - MARGIN_PX),
    )


def _holds(picture: Picture, points: Array) -> bool:
    height, width = picture.shape[:2]
    return bool((points >= -MARGIN_PX).all() and (points <= (width + MARGIN_PX, height + MARGIN_PX)).all())


def _to_opencv(points: Array) -> NDArray[np.int32]:
    return np.rint((points - 0.5) * 2**FRACTION_BITS).astype(np.int32)
