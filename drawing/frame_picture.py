"""The picture of one frame: the cameras with boxes in them, beside the bird's-eye view."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from ..runtime.frame import Camera, Frame, GroundTruth
from .bird_eye_view import draw_bird_eye_view
from .box_style import CLASS_COLOURS, GROUND_TRUTH_COLOUR, class_colour, style_ground_truth, style_detections
from .camera_panel import TEXT_COLOUR, draw_camera
from .canvas import Colour, Picture, blank, draw_circle, draw_text, text_width_px

BACKGROUND_COLOUR: Colour = (18, 15, 14)
FAINT_TEXT_COLOUR: Colour = (165, 160, 155)
DESIGN_HEIGHT_PX = 720  # the height of picture that the sizes of words and lines are given for
CAPTION_HEIGHT_PX = 36
GAP_PX = 4
SAME_AZIMUTH_RAD = np.deg2rad(5.0)


class PanelArea(NamedTuple):
    """Where a panel stands in the picture, in pixels."""

    left: int
    top: int
    width: int
    height: int


def draw_frame(
    frame: Frame,
    boxes: ArrayLike,
    classes: Sequence[str],
    scores: ArrayLike | None = None,
    *,
    ground_truth: GroundTruth | None = None,
    maps: Mapping[str, ArrayLike] | None = None,
    range_m: float = 51.2,
    height_px: int = 720,
    start_s: float | None = None,
) -> Picture:
    """Draw what is seen and what is found in it: (height_px, W, 3) uint8 BGR.

    boxes: (D, 9) in the ego frame: x y z w l h [m], yaw [rad], vx vy [m/s]; in the colours of their `classes`
        (D names). scores: (D,), written over boxes.
    truth: its boxes are drawn in thin green lines; its maps are drawn where they are passed as `maps`.
    maps: by name, (X, Y) probabilities or bool over [-range_m, range_m]; cell [i, j] is at x_i (forward) and
        y_j (left).
    height_px: even, so that a video can hold it; W is even, too, and depends on the cameras only.
    start_s: when given, the caption tells the time since then, otherwise the frame's token.
    """
    scale = height_px / DESIGN_HEIGHT_PX
    marks = [style_detections(boxes, classes, scores, scale)]
    if ground_truth is not None:
        marks.append(style_ground_truth(ground_truth, scale))
    caption_px = even(CAPTION_HEIGHT_PX * scale)
    body_px = height_px - caption_px
    gap_px = max(1, round(GAP_PX * scale))
    cells = lay_out_cameras(frame.cameras, body_px, gap_px)
    cameras_px = max(left + width for left, _, width, _ in cells.values()) if cells else 0
    picture = blank(even(cameras_px + gap_px + body_px), height_px, BACKGROUND_COLOUR)
    for name, (left, top, width, height) in cells.items():
        panel = draw_camera(name, frame.cameras[name], frame.images.get(name), marks, (width, height), scale)
        picture[top : top + height, left : left + width] = panel
    picture[:body_px, -body_px:] = draw_bird_eye_view(marks, maps or {}, range_m, body_px, scale)
    words = caption(frame, len(classes), ground_truth, start_s)
    used_px = _draw_caption(picture[body_px:], words, scale)
    _draw_legend(picture[body_px:, used_px:], legend(classes, ground_truth), scale)
    return picture


def lay_out_cameras(cameras: Mapping[str, Camera], height_px: int, gap_px: int) -> dict[str, PanelArea]:
    """Place the panels of cameras in two rows of `height_px` together, each amid a cell of one size.

    The front row reads from left to right; so does the back row, as seen by one who looks forward: what is
    on the left of the picture is on the left of the ego. A single row stands halfway up.
    """
    rows = [row for row in camera_rows(cameras) if row]
    cell_height = (height_px - gap_px) // 2
    aspect = max((camera.width_px / camera.height_px for camera in cameras.values()), default=1.0)
    cell_width = max(1, round(cell_height * aspect))
    num_columns = max((len(row) for row in rows), default=0)
    cells = {}
    for index, row in enumerate(rows):
        left = (num_columns - len(row)) * (cell_width + gap_px) // 2
        top = index * (cell_height + gap_px) if len(rows) == 2 else (height_px - cell_height) // 2
        for name in row:
            cells[name] = _fit(cameras[name], PanelArea(left, top, cell_width, cell_height))
            left += cell_width + gap_px
    return cells


def camera_rows(cameras: Mapping[str, Camera]) -> tuple[list[str], list[str]]:
    """The cameras that look ahead and the others, each from left to right by where they look.

    The front row is the half that looks least away from straight ahead, and whatever looks no further away.
    """
    azimuths = {name: azimuth_rad(camera) for name, camera in cameras.items()}
    away = sorted(abs(azimuth) for azimuth in azimuths.values())
    last = away[(len(away) - 1) // 2] + SAME_AZIMUTH_RAD if away else 0.0
    front = [name for name in azimuths if abs(azimuths[name]) <= last]
    back = [name for name in azimuths if abs(azimuths[name]) > last]
    return (
        sorted(front, key=lambda name: -azimuths[name]),
        sorted(back, key=lambda name: azimuths[name] % (2 * np.pi)),
    )


def azimuth_rad(camera: Camera) -> float:
    """Where a camera looks, seen from above: 0 ahead, positive to the left, in [-pi, pi]."""
    x, y = camera.camera_T_ego[2, :2]
    return float(np.arctan2(y, x))


def caption(frame: Frame, num_boxes: int, ground_truth: GroundTruth | None, start_s: float | None) -> str:
    """The line under the picture: scene, time or token, numbers of boxes."""
    time = frame.token if start_s is None else f"{frame.timestamp_s - start_s:+.2f} s"
    count = f"{num_boxes} box" + ("" if num_boxes == 1 else "es")
    known = "" if ground_truth is None else f"{len(ground_truth.classes)} true"
    return "    ".join(part for part in (frame.scene, time, count, known) if part)


def legend(classes: Sequence[str], ground_truth: GroundTruth | None) -> dict[str, Colour]:
    """Colours by name: the truth if it is drawn, the known classes, then what else is found."""
    colours = {} if ground_truth is None else {"truth": GROUND_TRUTH_COLOUR}
    return colours | CLASS_COLOURS | {name: class_colour(name) for name in sorted(set(classes))}


def even(pixels: float) -> int:
    """The next even number of pixels."""
    return 2 * int(np.ceil(pixels / 2))


def _fit(camera: Camera, cell: PanelArea) -> PanelArea:
    """The largest panel of a camera's shape in the middle of a cell."""
    scale = min(cell.width / camera.width_px, cell.height / camera.height_px)
    width = max(1, min(cell.width, round(scale * camera.width_px)))
    height = max(1, min(cell.height, round(scale * camera.height_px)))
    return PanelArea(cell.left + (cell.width - width) // 2, cell.top + (cell.height - height) // 2, width, height)


def _draw_caption(bar: Picture, words: str, scale: float) -> int:
    """Write the caption; returns the pixels of the bar's width that it takes."""
    height_px, pad_px = 16 * scale, 12 * scale
    draw_text(bar, words, pad_px, _baseline_px(bar, height_px), height_px, TEXT_COLOUR)
    return round(text_width_px(words, height_px) + 3 * pad_px)


def _draw_legend(bar: Picture, colours: Mapping[str, Colour], scale: float) -> None:
    """Write names after dots of their colours up to the end of the bar, as many as there is room for."""
    height_px, dot_px, pad_px = 13 * scale, 5 * scale, 12 * scale
    widths = {name: 3 * dot_px + text_width_px(name, height_px) + pad_px for name in colours}
    room_px = bar.shape[1] - sum(widths.values())
    left = max(0.0, room_px)
    for name, colour in colours.items():
        if left + widths[name] > bar.shape[1] + 1:
            return
        draw_circle(bar, (left + dot_px, bar.shape[0] / 2), dot_px, colour, cv2.FILLED)
        draw_text(bar, name, left + 3 * dot_px, _baseline_px(bar, height_px), height_px, FAINT_TEXT_COLOUR)
        left += widths[name]


def _baseline_px(bar: Picture, height_px: float) -> float:
    return bar.shape[0] / 2 + 0.36 * height_px
