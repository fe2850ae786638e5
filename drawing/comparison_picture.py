"""Pictures that compare several results with one ground truth, from above and in the cameras.

As in figure 5 of the paper, predictions are blue and true boxes are green. Each result has its own panels.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera, Frame, GroundTruth
from .bird_eye_view import draw_bird_eye_view
from .box_style import GROUND_TRUTH_COLOUR, PREDICTION_COLOUR, StyledBoxes, style_ground_truth, style_predictions
from .camera_panel import TEXT_COLOUR, draw_camera, panel_projection
from .canvas import Colour, Picture, blank, draw_text, fitting_height_px
from .ellipses import ELLIPSE_COLOUR, draw_ellipses_above, draw_ellipses_in_camera
from .footer import PAD_PX, draw_legend_bar, draw_text_bar
from .frame_picture import BACKGROUND_COLOUR
from .panel_layout import pad, place_below, place_beside

Array = NDArray[np.float64]

TITLE_PX = 30
TITLE_TEXT_PX = 16.0
VIEW_PX = 640  # width and height of a view from above
LARGEST_VIEW_COLUMNS = 4
CAMERA_ROW_PX = 2520  # width of a row of cameras
LARGEST_CAMERA_PX = 840  # width of one camera
LEAST_WIDTH_PX = 520


class NamedBoxes(NamedTuple):
    """The predicted boxes of one result. boxes: (D, 9) in the ego frame, as in `Detections.boxes`."""

    name: str
    boxes: Array


class Comparison(NamedTuple):
    """What the panels of one frame show.

    results: drawn in this order.
    ground_truth: drawn in every panel; None if it is unknown.
    marked: (M, 9) boxes with an ellipse around them in every panel.
    caption: written below the panels.
    """

    results: Sequence[NamedBoxes]
    ground_truth: GroundTruth | None
    marked: Array
    caption: str


def draw_comparison_above(comparison: Comparison, range_m: float) -> Picture:
    """Draw one view from above per result, side by side: (H, W, 3) uint8 BGR.

    range_m: of the views in x and y, from the ego.
    """
    views = [_titled(result.name, _draw_view(result, comparison, range_m)) for result in comparison.results]
    rows = [views[start : start + LARGEST_VIEW_COLUMNS] for start in range(0, len(views), LARGEST_VIEW_COLUMNS)]
    return _with_footer([place_beside(row) for row in rows], comparison)


def draw_comparison_in_cameras(comparison: Comparison, frame: Frame, names: Sequence[str]) -> Picture:
    """Draw one row of camera images per result: (H, W, 3) uint8 BGR.

    names: of the cameras, from left to right.
    """
    width_px = min(LARGEST_CAMERA_PX, CAMERA_ROW_PX // len(names))
    aspect = max(frame.cameras[name].height_px / frame.cameras[name].width_px for name in names)
    size_px = (width_px, round(width_px * aspect))
    rows = []
    for result in comparison.results:
        panels = [_draw_camera(name, frame, result, comparison, size_px) for name in names]
        rows.append(_titled(result.name, place_beside(panels)))
    return _with_footer(rows, comparison)


def _draw_view(result: NamedBoxes, comparison: Comparison, range_m: float) -> Picture:
    view = draw_bird_eye_view(_box_groups(result, comparison), {}, range_m, VIEW_PX, 1.0)
    draw_ellipses_above(view, comparison.marked, range_m)
    return view


def _draw_camera(
    name: str, frame: Frame, result: NamedBoxes, comparison: Comparison, cell_px: tuple[int, int]
) -> Picture:
    """Draw the largest panel with the aspect ratio of the camera that fits into a cell, centred in the cell."""
    camera, image = frame.cameras[name], frame.images.get(name)
    size_px = _fit(camera, cell_px)
    panel = draw_camera(name, camera, image, _box_groups(result, comparison), size_px, 1.0)
    if image is not None:
        draw_ellipses_in_camera(panel, comparison.marked, panel_projection(camera, size_px))
    cell = blank(*cell_px, BACKGROUND_COLOUR)
    left, top = (cell_px[0] - size_px[0]) // 2, (cell_px[1] - size_px[1]) // 2
    cell[top : top + size_px[1], left : left + size_px[0]] = panel
    return cell


def _fit(camera: Camera, cell_px: tuple[int, int]) -> tuple[int, int]:
    scale = min(cell_px[0] / camera.width_px, cell_px[1] / camera.height_px)
    return max(1, round(scale * camera.width_px)), max(1, round(scale * camera.height_px))


def _box_groups(result: NamedBoxes, comparison: Comparison) -> list[StyledBoxes]:
    """The true boxes, and the predictions above them."""
    truth = [] if comparison.ground_truth is None else [style_ground_truth(comparison.ground_truth, 1.0)]
    return [_comparable(group) for group in (*truth, style_predictions(result.boxes, 1.0))]


def _comparable(group: StyledBoxes) -> StyledBoxes:
    """The boxes without arrows of velocity, which would hide each other, and with equal line widths."""
    boxes = np.column_stack([group.boxes[:, :7], np.zeros((len(group.boxes), 2))])
    return replace(group, boxes=boxes, thickness_px=2, thin_px=1)


def _titled(title: str, panel: Picture) -> Picture:
    bar = blank(panel.shape[1], TITLE_PX, BACKGROUND_COLOUR)
    height_px = fitting_height_px(title, TITLE_TEXT_PX, panel.shape[1] - 2 * PAD_PX)
    draw_text(bar, title, PAD_PX, TITLE_PX / 2 + 0.4 * height_px, height_px, TEXT_COLOUR)
    return np.concatenate([bar, panel])


def _with_footer(rows: Sequence[Picture], comparison: Comparison) -> Picture:
    """Place the rows below each other, and the legend and the caption below them."""
    width_px = max(LEAST_WIDTH_PX, *(row.shape[1] for row in rows))
    bars = [
        draw_legend_bar(_legend(comparison), width_px),
        draw_text_bar([(comparison.caption, TEXT_COLOUR)], width_px),
    ]
    footer = np.concatenate(bars)
    return place_below([*(pad(row, width_px, len(row)) for row in rows), footer])


def _legend(comparison: Comparison) -> dict[str, Colour]:
    colours = {"predictions": PREDICTION_COLOUR}
    if comparison.ground_truth is not None:
        colours["ground truth"] = GROUND_TRUTH_COLOUR
    if len(comparison.marked):
        colours["found by some of the results only"] = ELLIPSE_COLOUR
    return colours
