"""Boxes in the global frame, where nuScenes' benchmark evaluates them.

A heading or a velocity of a box is a vector in the xy-plane of its frame. The ego may pitch and roll, so these planes
differ. A vector is rotated into the global frame, and its vertical part is dropped. This is how nuscenes-devkit reads a
submission, and the inverse of how a nuScenes root is read, see `data.nuscenes.annotated_boxes`.
"""

import numpy as np
from numpy.typing import NDArray

from ..runtime.geometry import transform

Array = NDArray[np.float64]

# nuScenes' annotations have 3 decimals. Rounding removes the errors of two transforms, about 1e-12 m, so that a true
# box is at the position of its annotation, and not on the other side of a class range or a matching distance.
DECIMALS = 9


def to_global(boxes: NDArray[np.floating], global_T_ego: Array) -> Array:
    """Return boxes (D, 9) of the ego frame in the global frame.

    boxes: x y z w l h [m], yaw [rad], vx vy [m/s]. A velocity may be unknown (NaN).
    global_T_ego: (4, 4).
    """
    turned = boxes.astype(np.float64)
    turned[:, :3] = np.round(transform(global_T_ego, turned[:, :3]), DECIMALS)
    turn = global_T_ego[:2, :2]
    headings = np.stack([np.cos(turned[:, 6]), np.sin(turned[:, 6])], axis=1) @ turn.T
    turned[:, 6] = np.arctan2(headings[:, 1], headings[:, 0])
    turned[:, 7:9] = turned[:, 7:9] @ turn.T
    return turned
