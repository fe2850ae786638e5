"""The picture of one frame: the camera panels, the bird's-eye view, and a caption with a legend."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike

from ..runtime.frame import Camera, Frame, GroundTruth
from .bird_eye_view import draw_bird_eye_view
from .box_style import CLASS_COLOURS, GROUND_TRUTH_COLOUR, class_colour, style_detections, style_ground_truth
from .camera_panel import TEXT_COLOUR, draw_camera
from .canvas import Colour, Picture, blank, draw_circle, draw_text, text_width_px

BACKGROUND_COLOUR: Colour = (18, 15, 14)
FAINT_TEXT_COLOUR: Colour = (165, 160, 155)
DESIGN_HEIGHT_PX = 720  # text sizes and line widths are given for a picture of this height
CAPTION_HEIGHT_PX = 36
GAP_PX = 4
SAME_AZIMUTH_RAD = np.deg2rad(5.0)


class PanelArea(NamedTuple):
    """The area of a camera panel in the picture [px]."""

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
    """Draw a frame with its detections: (height_px, W, 3) uint8 BGR.

    boxes: (D, 9) in the ego frame: x y z w l h [m], yaw [rad], vx vy [m/s].
    classes: D names, which give the colours of the boxes.
    scores: (D,), written above the boxes in the camera images.
    ground_truth: its boxes are drawn with thin green lines. To draw its maps, pass them as `maps`.
    maps: by name, (X, Y) probabilities or bool over [-range_m, range_m]. Cell [i, j] is at x_i (forward) and y_j
        (left).
    range_m: of the bird's-eye view in x and y.
    height_px: even, because videos need an even size. W is even, too, and depends on the cameras only.
    start_s: the time from which the caption counts. If None, the caption shows the token of the frame instead.

    Raises ValueError if the numbers of boxes, classes and scores differ.
    """
    scale = height_px / DESIGN_HEIGHT_PX
    box_groups = [style_detections(boxes, classes, scores, scale)]
    if ground_truth is not None:
        box_groups.append(style_ground_truth(ground_truth, scale))
    caption_px = round_up_to_even(CAPTION_HEIGHT_PX * scale)
    body_px = height_px - caption_px
    gap_px = max(1, round(GAP_PX * scale))
    areas = lay_out_cameras(frame.cameras, body_px, gap_px)
    cameras_px = max(left + width for left, _, width, _ in areas.values()) if areas else 0
    picture = blank(round_up_to_even(cameras_px + gap_px + body_px), height_px, BACKGROUND_COLOUR)
    for name, (left, top, width, height) in areas.items():
        panel = draw_camera(name, frame.cameras[name], frame.images.get(name), box_groups, (width, height), scale)
        picture[top : top + height, left : left + width] = panel
    picture[:body_px, -body_px:] = draw_bird_eye_view(box_groups, maps or {}, range_m, body_px, scale)
    text = caption(frame, len(classes), ground_truth, start_s)
    used_px = _draw_caption(picture[body_px:], text, scale)
    _draw_legend(picture[body_px:, used_px:], legend(classes, ground_truth), scale)
    return picture


def lay_out_cameras(cameras: Mapping[str, Camera], height_px: int, gap_px: int) -> dict[str, PanelArea]:
    """The areas of camera panels by name, in two rows with a total height of `height_px`.

    Each panel is centred in a cell, and all cells have the same size. Panels on the left show the left side of the
    ego, in the front row and in the back row. A single row is centred vertically.
    """
    rows = [row for row in camera_rows(cameras) if row]
    cell_height = (height_px - gap_px) // 2
    aspect = max((camera.width_px / camera.height_px for camera in cameras.values()), default=1.0)
    cell_width = max(1, round(cell_height * aspect))
    num_columns = max((len(row) for row in rows), default=0)
    areas = {}
    for index, row in enumerate(rows):
        left = (num_columns - len(row)) * (cell_width + gap_px) // 2
        top = index * (cell_height + gap_px) if len(rows) == 2 else (height_px - cell_height) // 2
        for name in row:
            areas[name] = _fit(cameras[name], PanelArea(left, top, cell_width, cell_height))
            left += cell_width + gap_px
    return areas


def camera_rows(cameras: Mapping[str, Camera]) -> tuple[list[str], list[str]]:
    """The camera names of the front row and of the back row, each from left to right.

    The front row has half of the cameras: those with the smallest absolute azimuths. Cameras with about
    the same absolute azimuth as the last of these are added.
    """
    azimuths = {name: azimuth_rad(camera) for name, camera in cameras.items()}
    sorted_azimuths = sorted(abs(azimuth) for azimuth in azimuths.values())
    largest = sorted_azimuths[(len(sorted_azimuths) - 1) // 2] + SAME_AZIMUTH_RAD if sorted_azimuths else 0.0
    front = [name for name in azimuths if abs(azimuths[name]) <= largest]
    back = [name for name in azimuths if abs(azimuths[name]) > largest]
    return (
        sorted(front, key=lambda name: -azimuths[name]),
        sorted(back, key=lambda name: azimuths[name] % (2 * np.pi)),
    )


def azimuth_rad(camera: Camera) -> float:
    """The azimuth of a camera's optical axis in the ego frame: 0 ahead, positive to the left, in [-pi, pi]."""
    x, y = camera.camera_T_ego[2, :2]
    return float(np.arctan2(y, x))


def caption(frame: Frame, num_boxes: int, ground_truth: GroundTruth | None, start_s: float | None) -> str:
    """The text below the picture: scene, time or token, numbers of boxes."""
    time = frame.token if start_s is None else f"{frame.timestamp_s - start_s:+.2f} s"
    count = f"{num_boxes} box" + ("" if num_boxes == 1 else "es")
    truth = "" if ground_truth is None else f"{len(ground_truth.classes)} ground truth"
    return "    ".join(part for part in (frame.scene, time, count, truth) if part)


def legend(classes: Sequence[str], ground_truth: GroundTruth | None) -> dict[str, Colour]:
    """Colours by name: the ground truth if there is one, the known classes, then other classes of the boxes."""
    colours = {} if ground_truth is None else {"ground truth": GROUND_TRUTH_COLOUR}
    return colours | CLASS_COLOURS | {name: class_colour(name) for name in sorted(set(classes))}


def round_up_to_even(pixels: float) -> int:
    """Round up to an even number of pixels."""
    return 2 * int(np.ceil(pixels / 2))


def _fit(camera: Camera, cell: PanelArea) -> PanelArea:
    """The area of the largest panel with the aspect ratio of a camera, centred in a cell."""
    scale = min(cell.width / camera.width_px, cell.height / camera.height_px)
    width = max(1, min(cell.width, round(scale * camera.width_px)))
    height = max(1, min(cell.height, round(scale * camera.height_px)))
    return PanelArea(cell.left + (cell.width - width) // 2, cell.top + (cell.height - height) // 2, width, height)


def _draw_caption(bar: Picture, text: str, scale: float) -> int:
    """Write the caption and return the width that it takes [px]."""
    height_px, pad_px = 16 * scale, 12 * scale
    draw_text(bar, text, pad_px, _baseline_px(bar, height_px), height_px, TEXT_COLOUR)
    return round(text_width_px(text, height_px) + 3 * pad_px)


def _draw_legend(bar: Picture, colours: Mapping[str, Colour], scale: float) -> None:
    """Write names with dots in their colours, right-aligned. Names that do not fit into the bar are left out."""
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
