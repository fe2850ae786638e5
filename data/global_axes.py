"""Boxes in axes that are parallel to the global frame, with the origin at the ego: the axes of nuScenes' benchmark.

A heading or a velocity of a box is a vector in the xy-plane of its frame. The ego may pitch and roll, so these planes
differ. A vector is rotated into the global frame, and its vertical part is dropped. This is how nuscenes-devkit reads a
submission.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def to_global_axes(boxes: NDArray[np.floating], global_T_ego: Array) -> Array:
    """Turn boxes (D, 9) of the ego frame into axes parallel to the global frame. The origin stays at the ego.

    boxes: x y z w l h [m], yaw [rad], vx vy [m/s]. A velocity may be unknown (NaN).
    global_T_ego: (4, 4); only its rotation is used.
    """
    turned = boxes.astype(np.float64)
    turned[:, :3] = turned[:, :3] @ global_T_ego[:3, :3].T
    turn = global_T_ego[:2, :2]
    headings = np.stack([np.cos(turned[:, 6]), np.sin(turned[:, 6])], axis=1) @ turn.T
    turned[:, 6] = np.arctan2(headings[:, 1], headings[:, 0])
    turned[:, 7:9] = turned[:, 7:9] @ turn.T
    return turned
