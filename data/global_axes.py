"""Boxes in axes that are parallel to the global frame, with the origin at the ego: the axes of nuScenes' benchmark.

A heading or a velocity of a box is a vector in the xy-plane of its frame. The ego may pitch and roll, so these planes
differ. Both functions map a vector to the one with the same projection along global z, and are inverses of each other.
This is also how nuscenes-devkit reads a submission: it drops the vertical part of a heading and of a velocity.
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
    return _turn_in_plane(turned, global_T_ego[:2, :2])


def to_ego_axes(boxes: NDArray[np.floating], global_T_ego: Array) -> Array:
    """Turn boxes (D, 9) back to the ego frame: the inverse of `to_global_axes`.

    Raises ValueError if the ego's z axis is horizontal in the global frame.
    """
    turned = boxes.astype(np.float64)
    turned[:, :3] = turned[:, :3] @ global_T_ego[:3, :3]
    (a, b), (c, d) = global_T_ego[:2, :2]
    if abs(determinant := a * d - b * c) < 1e-6:
        raise ValueError("expected an ego pose whose z axis is not horizontal")
    return _turn_in_plane(turned, np.array([[d, -b], [-c, a]]) / determinant)


def _turn_in_plane(boxes: Array, turn: Array) -> Array:
    """Apply a matrix (2, 2) to the headings and velocities of boxes (D, 9), in place."""
    headings = np.stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6])], axis=1) @ turn.T
    boxes[:, 6] = np.arctan2(headings[:, 1], headings[:, 0])
    boxes[:, 7:9] = boxes[:, 7:9] @ turn.T
    return boxes
