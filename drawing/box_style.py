"""The style of boxes: colours, line widths and labels."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..runtime.frame import GroundTruth
from .canvas import Colour

GROUND_TRUTH_COLOUR: Colour = (118, 230, 0)  # green, as in the paper; no class has this colour
PREDICTION_COLOUR: Colour = (255, 120, 40)  # blue, as in the paper, where results are compared

CLASS_COLOURS: dict[str, Colour] = {  # BGR
    "car": (255, 165, 64),
    "truck": (66, 150, 255),
    "construction_vehicle": (60, 175, 214),
    "bus": (120, 90, 255),
    "trailer": (255, 130, 180),
    "barrier": (190, 180, 170),
    "motorcycle": (205, 105, 255),
    "bicycle": (235, 225, 80),
    "pedestrian": (70, 220, 255),
    "traffic_cone": (50, 80, 255),
}


@dataclass(frozen=True)
class StyledBoxes:
    """A group of boxes drawn in the same style.

    boxes: (D, 9) in the ego frame: x y z w l h [m], yaw [rad], vx vy [m/s].
    colours, labels: D each. An empty label is not written.
    thickness_px: line width of large boxes in a camera image.
    thin_px: line width of small boxes, and of all boxes in the bird's-eye view.
    solid: whether the front faces in camera images, and the areas in the bird's-eye view, are tinted.
    """

    boxes: NDArray[np.float64]
    colours: Sequence[Colour]
    labels: Sequence[str]
    thickness_px: int
    thin_px: int
    solid: bool


def style_detections(boxes: ArrayLike, classes: Sequence[str], scores: ArrayLike | None, scale: float) -> StyledBoxes:
    """Style detections: in the colours of their classes, labelled with their scores.

    boxes: (D, 9).
    classes: D names.
    scores: (D,), or None for no labels.
    scale: of line widths.

    Raises ValueError if the numbers of boxes, classes and scores differ.
    """
    boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 9)
    labels = [""] * len(boxes) if scores is None else [f"{score:.2f}" for score in np.asarray(scores)]
    if not len(boxes) == len(classes) == len(labels):
        raise ValueError(
            "expected one class and one score per box; "
            f"got {len(boxes)} boxes, {len(classes)} classes and {len(labels)} scores"
        )
    colours = [class_colour(name) for name in classes]
    return StyledBoxes(boxes, colours, labels, line_px(2 * scale), line_px(scale), solid=True)


def style_ground_truth(ground_truth: GroundTruth, scale: float) -> StyledBoxes:
    """Style ground-truth boxes: green, with thin lines that do not hide the detections."""
    boxes = np.asarray(ground_truth.boxes, dtype=np.float64).reshape(-1, 9)
    colours = [GROUND_TRUTH_COLOUR] * len(boxes)
    return StyledBoxes(boxes, colours, [""] * len(boxes), line_px(scale), line_px(scale), solid=False)


def style_predictions(boxes: ArrayLike, scale: float) -> StyledBoxes:
    """Style predictions (D, 9) for a comparison with the ground truth: blue, without labels and areas."""
    boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 9)
    colours = [PREDICTION_COLOUR] * len(boxes)
    return StyledBoxes(boxes, colours, [""] * len(boxes), line_px(scale), line_px(scale), solid=False)


def class_colour(name: str) -> Colour:
    """The colour of a class. An unknown name gets one of the known colours, the same on every call."""
    if name in CLASS_COLOURS:
        return CLASS_COLOURS[name]
    return list(CLASS_COLOURS.values())[zlib.crc32(name.encode()) % len(CLASS_COLOURS)]


def line_px(width_px: float) -> int:
    """Round a line width to whole pixels, at least 1, as OpenCV requires."""
    return max(1, round(width_px))
