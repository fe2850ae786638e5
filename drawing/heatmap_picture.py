"""The picture of a frame's features, as in figure 2 of the paper: images, PV heatmaps, the BEV heatmap and patches.

Each image is the part that the network sees. Its PV heatmap is at the same place in the block below. The patches show
a few objects enlarged: in the image, in the PV heatmap and in the BEV heatmap.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.frame import Camera, Frame
from ..runtime.geometry import NEAREST_DEPTH_M, box_corners, transform
from .bird_eye_view import to_view_pixels
from .camera_panel import EDGES, TEXT_COLOUR, draw_name, project_segments
from .canvas import Colour, Picture, blank, draw_outline, draw_text, fitting_height_px
from .feature_panels import (
    FeatureMaps,
    cut_square,
    draw_bev_heat,
    draw_network_image,
    draw_pv_heat,
    network_projection,
)
from .footer import draw_text_bar
from .frame_picture import BACKGROUND_COLOUR, camera_rows
from .panel_layout import GAP_PX, pad, place_below, place_beside

Array = NDArray[np.float64]
Panels = Mapping[str, Picture]

BLOCK_PX = 1260  # width of the block of images, and of that of PV heatmaps
LARGEST_PANEL_PX = 840  # width of one image, if there are few cameras
LEAST_VIEW_PX = 420  # width and height of the BEV heatmap
WIDE_GAP_PX = 18
PATCH_PX = 150
MAX_PATCHED_OBJECTS = 4
PATCH_MARGIN = 1.3  # a patch is larger than its object by this factor
LEAST_PATCH_PX = 24.0  # width and height of the part of an image that a patch shows
PATCH_MARGIN_M = 3.0
SAME_PLACE_M = 2.0  # detections that are nearer to each other are taken for the same object
TITLE_PX, TITLE_TEXT_PX, LETTER_PX = 26, 14.0, 14.0
MARK_COLOUR: Colour = (255, 255, 90)  # cyan, which the heat does not have
RIM_COLOUR: Colour = (20, 20, 20)
LETTERS = "ABCDEFGH"


class DetectedObject(NamedTuple):
    """An object that may have patches. box: (9,) in the ego frame. title: its class and score."""

    box: Array
    title: str


class Place(NamedTuple):
    """The square around an object in the panel of a camera, or in the BEV heatmap. centre: (2,) [px]."""

    centre: Array
    side_px: float

    @property
    def corners(self) -> Array:
        """(4, 2) [px], from the upper left one."""
        return self.centre + np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * self.side_px


class _Mark(NamedTuple):
    """The mark of an object in a panel."""

    picture: Picture
    place: Place
    letter: str


class _Canvases(NamedTuple):
    """The panels of a frame. heats is empty without PV features, and view is None without BEV features."""

    images: Panels
    heats: Panels
    view: Picture | None
    range_m: float


def draw_heatmaps(
    frame: Frame,
    features: FeatureMaps,
    objects: Sequence[DetectedObject],
    preprocessing: Preprocessing,
    range_m: float,
    notes: Sequence[str] = (),
) -> Picture:
    """Draw the features of a frame beside its images: (H, W, 3) uint8 BGR.

    objects: the first of them that are visible in an image, and not at the same place, have patches.
    preprocessing: says which part of an image the network sees.
    range_m: of the BEV features in x and y, from the ego.
    notes: lines of text below the picture.
    """
    rows = [row for row in camera_rows(frame.cameras) if row]
    size_px = _panel_size(max((len(row) for row in rows), default=1), preprocessing)
    images = {
        name: draw_network_image(frame.images.get(name), camera, preprocessing, size_px)
        for name, camera in frame.cameras.items()
    }
    heats = {name: _empty_like(image) for name, image in images.items()} if features.pv is not None else {}
    heats |= draw_pv_heat(features.pv or {}, preprocessing, size_px)
    blocks_px = (2 if heats else 1) * len(rows) * (size_px[1] + GAP_PX) - GAP_PX
    view = None if features.bev is None else draw_bev_heat(features.bev, range_m, max(LEAST_VIEW_PX, blocks_px))
    canvases = _Canvases(images, heats, view, range_m)
    strips, marks = _patches(_choose(frame, objects, preprocessing, size_px), canvases)
    for name in images:
        draw_name(images[name], name, 1.0)
    _draw_marks(marks)
    body = place_below([_block(panels, rows) for panels in (images, heats) if panels])
    body = body if view is None else place_beside([body, view])
    parts = [body, place_beside(strips, WIDE_GAP_PX)] if strips else [body]
    width_px = max(part.shape[1] for part in parts)
    parts.append(draw_text_bar([(note, TEXT_COLOUR) for note in notes], width_px))
    return place_below([pad(part, width_px, len(part)) for part in parts])


def _panel_size(num_columns: int, preprocessing: Preprocessing) -> tuple[int, int]:
    width = min(LARGEST_PANEL_PX, BLOCK_PX // num_columns)
    return width, max(1, round(width * preprocessing.height_px / preprocessing.width_px))


def _choose(
    frame: Frame, objects: Sequence[DetectedObject], preprocessing: Preprocessing, size_px: tuple[int, int]
) -> Iterator[tuple[DetectedObject, str, Place]]:
    """Yield the objects that have patches, with the camera that shows each, and its place there."""
    chosen: list[Array] = []
    for each in objects:
        is_new = all(np.linalg.norm(each.box[:2] - box[:2]) >= SAME_PLACE_M for box in chosen)
        shown = _facing_camera(frame, each.box, preprocessing, size_px) if is_new else None
        if shown is not None:
            chosen.append(each.box)
            yield each, *shown
        if len(chosen) == MAX_PATCHED_OBJECTS:
            return


def _facing_camera(
    frame: Frame, box: Array, preprocessing: Preprocessing, size_px: tuple[int, int]
) -> tuple[str, Place] | None:
    """The camera that shows an object and faces it most directly, and its place there. None if no camera shows it."""
    for name in sorted(frame.cameras, key=lambda name: -_cosine(frame.cameras[name], box)):
        if frame.images.get(name) is not None:
            panel_T_ego = network_projection(frame.cameras[name], preprocessing, size_px)
            low, high = _visible_corners(box, panel_T_ego, size_px)
            if np.prod(high - low) > 0:
                return name, _place_in_panel(low, high, size_px)
    return None


def _cosine(camera: Camera, box: Array) -> float:
    """The cosine of the angle between a camera's optical axis and the direction to the centre of a box."""
    centre_m = transform(camera.camera_T_ego, box[:3])
    return float(centre_m[2] / max(np.linalg.norm(centre_m), NEAREST_DEPTH_M))


def _place_in_panel(low: Array, high: Array, size_px: tuple[int, int]) -> Place:
    """The square around the visible part of an object, moved into the panel."""
    side_px = min(max(LEAST_PATCH_PX, PATCH_MARGIN * float(np.max(high - low))), float(min(size_px)))
    return Place(np.clip((low + high) / 2, side_px / 2, np.array(size_px) - side_px / 2), side_px)


def _visible_corners(box: Array, panel_T_ego: Array, size_px: tuple[int, int]) -> tuple[Array, Array]:
    """The upper left and the lower right corner of the visible part of a box [px]; equal if it is not visible."""
    points = project_segments(box_corners(box)[0][EDGES], panel_T_ego).reshape(-1, 2)
    if len(points) == 0 or not np.isfinite(points).all():
        return np.zeros(2), np.zeros(2)
    points = np.clip(points, 0, size_px)
    return points.min(axis=0), points.max(axis=0)


def _patches(
    chosen: Iterator[tuple[DetectedObject, str, Place]], canvases: _Canvases
) -> tuple[list[Picture], list[_Mark]]:
    """Cut the patches of each object. Returns them, and the marks that show their places in the panels."""
    strips, marks = [], []
    for letter, (each, name, place) in zip(LETTERS, chosen, strict=False):
        places = [(panels[name], place) for panels in (canvases.images, canvases.heats) if panels]
        if canvases.view is not None:
            places.append((canvases.view, _place_above(each.box, canvases.range_m, len(canvases.view))))
        patches = place_beside([cut_square(picture, *where, PATCH_PX) for picture, where in places])
        strips.append(np.concatenate([_title(f"{letter}: {each.title}", patches.shape[1]), patches]))
        marks += [_Mark(picture, where, letter) for picture, where in places]
    return strips, marks


def _draw_marks(marks: Sequence[_Mark]) -> None:
    """Draw the squares of all objects, then their letters, so that no square hides a letter."""
    for picture, place, _ in marks:
        for colour, thickness_px in ((RIM_COLOUR, 4), (MARK_COLOUR, 2)):
            draw_outline(picture, place.corners, colour, thickness_px)
    for mark in marks:
        _write_letter(*mark)


def _place_above(box: Array, range_m: float, view_px: int) -> Place:
    side_m = float(np.hypot(box[3], box[4])) + 2 * PATCH_MARGIN_M
    return Place(to_view_pixels(box[:2], range_m, view_px), side_m * view_px / (2 * range_m))


def _write_letter(picture: Picture, place: Place, letter: str) -> None:
    """Write the letter of an object with a dark rim into the upper right corner of its square."""
    inside = np.array([picture.shape[1] - LETTER_PX - 4, len(picture) - 5])
    left, baseline = np.clip(place.corners[1] + (-LETTER_PX - 4, LETTER_PX + 5), (4, LETTER_PX + 5), inside)
    for right, down in product((-1, 0, 1), repeat=2):
        draw_text(picture, letter, left + right, baseline + down, LETTER_PX, RIM_COLOUR)
    draw_text(picture, letter, left, baseline, LETTER_PX, MARK_COLOUR)


def _title(text: str, width_px: int) -> Picture:
    bar = blank(width_px, TITLE_PX, BACKGROUND_COLOUR)
    height_px = fitting_height_px(text, TITLE_TEXT_PX, width_px - 8)
    draw_text(bar, text, 4, TITLE_PX / 2 + 0.45 * height_px, height_px, TEXT_COLOUR)
    return bar


def _empty_like(image: Picture) -> Picture:
    return blank(image.shape[1], image.shape[0], (0, 0, 0))


def _block(panels: Panels, rows: Sequence[Sequence[str]]) -> Picture:
    """The panels of the cameras in rows, each row centred."""
    lines = [place_beside([panels[name] for name in row]) for row in rows]
    width_px = max((line.shape[1] for line in lines), default=1)
    return place_below([pad(line, width_px, len(line), centred=True) for line in lines])
