"""The boxes that nuScenes' benchmark leaves out, as `filter_eval_boxes` in nuscenes-devkit 1.2.0 does.

These are boxes beyond the range of their class, true boxes without lidar or radar points, and bicycles and motorcycles
whose centre is within a bicycle rack. Racks are annotated as `static_object.bicycle_rack`.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..data.box_selection import BoxSelection, select_boxes
from ..data.class_names import BICYCLE_RACK
from ..runtime.frame import GroundTruth
from ..runtime.geometry import rotation_z
from .boxes import planar_norms
from .protocol import CLASS_RANGES_M, CLASSES

ORIGIN = np.zeros(3)
RACK_CLASSES = ("bicycle", "motorcycle")  # the classes that a bicycle rack hides


def select_true_boxes(ground_truth: GroundTruth, place: str, ego_m: NDArray[np.float64] = ORIGIN) -> BoxSelection:
    """Select the true boxes that the benchmark evaluates.

    place: where the boxes are, for the error.
    ego_m: (3,) position of the ego, in the frame of the boxes.

    Raises InputError for class names that are not known.
    """
    selection = select_boxes(ground_truth, CLASSES, place)
    ranges_m = np.array([CLASS_RANGES_M[name] for name in selection.classes])
    distances_m = planar_norms(selection.boxes[:, :2] - ego_m[:2])
    selection = selection.keep(distances_m < ranges_m, "range").keep_observed()
    in_rack = is_in_rack(selection.boxes, selection.classes, bicycle_racks(ground_truth))
    return selection.keep(~in_rack, "bicycle_rack")


def bicycle_racks(ground_truth: GroundTruth) -> NDArray[np.float64]:
    """The boxes (R, 9) of the bicycle racks."""
    mapping = ground_truth.class_mapping
    is_rack = [BICYCLE_RACK in (name, mapping.get(name)) for name in ground_truth.classes]
    return ground_truth.boxes[np.array(is_rack, np.bool_)]


def is_in_rack(boxes: NDArray[np.floating], classes: Sequence[str], racks: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each box (D, 9) is a bicycle or motorcycle with its centre in a rack, faces included. Returns (D,)."""
    in_rack = np.zeros(len(boxes), np.bool_)
    centres = boxes[:, :3].astype(np.float64)
    for rack in racks:
        offsets = (centres - rack[:3]) @ rotation_z(rack[6])  # in the rack's axes: along its length, width and height
        in_rack |= (np.abs(offsets) <= rack[[4, 3, 5]] / 2).all(axis=1)
    return in_rack & np.isin(np.array(classes, np.str_), RACK_CLASSES)
