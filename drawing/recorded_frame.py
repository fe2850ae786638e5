"""What a recording for a viewer holds of one frame, and the conversions that all formats of recordings need."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from ..runtime.frame import Camera, Frame, GroundTruth
from ..runtime.geometry import nearest_rigid
from ..runtime.printable import printable
from .bird_eye_view import MAP_COLOURS, OTHER_MAP_COLOUR
from .box_style import GROUND_TRUTH_COLOUR, class_colour
from .canvas import Colour

Array = NDArray[np.float64]

APPLICATION = "duospacenet"  # near the start of every recording; shows that this toolkit wrote it
JPEG_QUALITY = 90
EARLIEST_S, LATEST_S = 0.0, float(2**32 - 1)  # the range of time stamps in Foxglove's messages


class MapArea(NamedTuple):
    """The part of the ego frame that maps cover, in x and y [m]."""

    lower_m: tuple[float, float]
    upper_m: tuple[float, float]


class RecordedBoxes(NamedTuple):
    """Boxes of one kind in the ego frame, without those that are not finite.

    centres_m: (D, 3). sizes_m: (D, 3), along the heading, across it and up. yaws_rad: (D,).
    velocities_m_s: (D, 2) over ground, NaN where unknown.
    colours: D. labels: D texts.
    """

    centres_m: Array
    sizes_m: Array
    yaws_rad: Array
    velocities_m_s: Array
    colours: list[Colour]
    labels: list[str]


class RecordedFrame(NamedTuple):
    """The content of one frame of a recording.

    boxes: the predictions. ground_truth: the true boxes; None if they are unknown.
    maps: (X, Y) uint8 by name, 255 for a probability of 1; [i, j] is the cell at x_i (forward) and y_j (left).
    map_area: of the maps.
    """

    frame: Frame
    boxes: RecordedBoxes
    ground_truth: RecordedBoxes | None
    maps: Mapping[str, NDArray[np.uint8]]
    map_area: MapArea


def predicted_boxes(boxes: Array, classes: Sequence[str], scores: Sequence[float]) -> RecordedBoxes:
    """Predictions (D, 9) in the colours of their classes, labelled with class and score."""
    labels = [f"{printable(name)} {score:.2f}" for name, score in zip(classes, scores, strict=True)]
    return _finite_boxes(boxes, [class_colour(name) for name in classes], labels)


def true_boxes(ground_truth: GroundTruth) -> RecordedBoxes:
    """The true boxes in green, labelled with their classes."""
    names = [printable(name) for name in ground_truth.classes]
    return _finite_boxes(ground_truth.boxes, [GROUND_TRUTH_COLOUR] * len(names), names)


def nanoseconds(timestamp_s: float) -> int:
    """A time stamp in whole microseconds, as ns. A float64 has no finer steps at today's times."""
    return round(timestamp_s * 1e6) * 1000


def encode_jpeg(image: NDArray[np.uint8]) -> bytes:
    """Encode an image (height, width, 3) uint8 BGR."""
    return bytes(simplejpeg.encode_jpeg(np.ascontiguousarray(image), quality=JPEG_QUALITY, colorspace="BGR"))


def scaled_intrinsics(camera: Camera, image: NDArray[np.uint8] | None) -> Array:
    """The intrinsics (3, 3) [px] of an image; the centre of its first pixel is at (0.5, 0.5).

    image: may be smaller than the calibration says, after reduced decoding; None for a lost camera.
    """
    width, height = image_size(camera, image)
    resize = np.diag([width / camera.width_px, height / camera.height_px, 1.0])
    return resize @ camera.intrinsics_px


def image_size(camera: Camera, image: NDArray[np.uint8] | None) -> tuple[int, int]:
    """Width and height [px] of the image, or of the calibration for a lost camera."""
    return (camera.width_px, camera.height_px) if image is None else (image.shape[1], image.shape[0])


def rigid(a_T_b: NDArray) -> Array:
    """A pose (4, 4) whose rotation is exactly orthonormal."""
    return nearest_rigid(np.asarray(a_T_b, dtype=np.float64))


def map_pixels(name: str, mask: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A map as RGBA pixels (Y, X, 4): the first row is at the lowest y, the first column at the lowest x.

    The opacity is the probability.
    """
    blue, green, red = MAP_COLOURS.get(name, OTHER_MAP_COLOUR)
    pixels = np.empty((*mask.T.shape, 4), np.uint8)
    pixels[..., :3] = red, green, blue
    pixels[..., 3] = mask.T
    return pixels


def cell_size(mask: NDArray[np.uint8], area: MapArea) -> Array:
    """The size (2,) [m] of a map's cells in x and y."""
    return (np.array(area.upper_m) - area.lower_m) / mask.shape


def to_square_cells(mask: NDArray[np.uint8], area: MapArea) -> NDArray[np.uint8]:
    """The map with cells that are as long as they are wide, for viewers without other cells."""
    cells_m, extent_m = cell_size(mask, area), np.array(area.upper_m) - area.lower_m
    num_x, num_y = np.maximum(1, np.rint(extent_m / cells_m.min())).astype(int)
    if mask.shape == (num_x, num_y):
        return mask
    return np.asarray(cv2.resize(mask, (num_y, num_x), interpolation=cv2.INTER_NEAREST), np.uint8)


def _finite_boxes(boxes: NDArray, colours: Sequence[Colour], labels: Sequence[str]) -> RecordedBoxes:
    boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 9)
    kept = np.flatnonzero(np.isfinite(boxes[:, :7]).all(axis=1)).tolist()
    boxes = boxes[kept]
    return RecordedBoxes(
        boxes[:, :3],
        boxes[:, [4, 3, 5]],
        boxes[:, 6],
        boxes[:, 7:9],
        [colours[row] for row in kept],
        [labels[row] for row in kept],
    )
