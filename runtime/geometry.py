"""Rigid transforms, the pinhole camera and box corners, in float64 numpy.

`a_T_b` maps points of frame b to frame a. Frames: `global`, `ego` (x forward, y left, z up), `camera`
(z forward, x right, y down), `image` (pixels; the centre of the first pixel is at (0.5, 0.5)).
Units are metres and radians unless a name says otherwise.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

NEAREST_DEPTH_M = 0.1  # points nearer to the camera's plane, or behind it, are not visible
# Camera axes from body axes: a body has x forward, y left, z up; a camera has z forward, x right, y down.
CAMERA_R_BODY = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])


def inverse(a_T_b: Array) -> Array:
    """Return `b_T_a` of a rigid transform `a_T_b`, both (..., 4, 4)."""
    # Transposing the rotation is exact. A general inverse would lose digits of poses far from the origin.
    b_R_a = np.swapaxes(a_T_b[..., :3, :3], -1, -2)
    b_T_a = np.zeros_like(a_T_b)
    b_T_a[..., :3, :3] = b_R_a
    b_T_a[..., :3, 3:] = -b_R_a @ a_T_b[..., :3, 3:]
    b_T_a[..., 3, 3] = 1.0
    return b_T_a


def nearest_rigid(a_T_b: Array) -> Array:
    """Return `a_T_b` (4, 4) with its rotation replaced by the nearest orthonormal one, to remove rounding errors."""
    u, _, vh = np.linalg.svd(a_T_b[:3, :3])
    return rigid_transform(u @ vh, a_T_b[:3, 3])


def transform(a_T_b: Array, points_b: Array) -> Array:
    """Map points (..., 3) [m] of frame b to frame a by `a_T_b` (4, 4)."""
    return points_b @ a_T_b[:3, :3].T + a_T_b[:3, 3]


def rotation_z(yaw_rad: float) -> Array:
    """Return the rotation (3, 3) by `yaw_rad` about z, counter-clockwise seen from above."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def quaternion_from_rotation(rotation: Array) -> Array:
    """Return the unit quaternion (4,) of a rotation (3, 3): w first, and w is not negative."""
    # The matrix below is 4 q qᵀ, so each row is the quaternion times one of its elements. The row of the largest
    # element has the smallest rounding error.
    (a, b, c), (d, e, f), (g, h, i) = rotation
    products = np.array(
        [
            [1 + a + e + i, h - f, c - g, d - b],
            [h - f, 1 + a - e - i, b + d, c + g],
            [c - g, b + d, 1 - a + e - i, f + h],
            [d - b, c + g, f + h, 1 - a - e + i],
        ]
    )
    longest = products[np.argmax(np.diag(products))]
    return np.where(longest[0] < 0, -1, 1) * longest / np.linalg.norm(longest)


def rotation_from_quaternion(quaternion: Array) -> Array:
    """Return the rotation (3, 3) of a unit quaternion (4,), w first."""
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rotation_angle(rotation: Array) -> float:
    """Return the angle [rad] of a rotation (3, 3) about its axis, from 0 to pi."""
    return float(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))


def rigid_transform(rotation: ArrayLike, translation_m: ArrayLike) -> Array:
    """Return the rigid transform (4, 4) of a rotation (3, 3) and a translation (3,) [m]."""
    a_T_b = np.eye(4)
    a_T_b[:3, :3] = rotation
    a_T_b[:3, 3] = translation_m
    return a_T_b


def image_T_ego(intrinsics_px: Array, camera_T_ego: Array) -> Array:
    """Return the projection (3, 4) from the ego frame to homogeneous pixels, K [R | t].

    intrinsics_px: (3, 3).
    camera_T_ego: (4, 4).
    """
    return intrinsics_px @ camera_T_ego[:3]


def project(points: Array, image_T_frame: Array) -> tuple[Array, Array]:
    """Project points (..., 3) [m] by a projection (3, 4).

    Returns pixels (..., 2) and depths [m] (...,). Pixels are valid only where the depth is at least
    `NEAREST_DEPTH_M`; elsewhere they are finite but meaningless.
    """
    homogeneous = points @ image_T_frame[:, :3].T + image_T_frame[:, 3]
    depth_m = homogeneous[..., 2]
    return homogeneous[..., :2] / np.maximum(depth_m, NEAREST_DEPTH_M)[..., None], depth_m


def box_corners(boxes: Array) -> Array:
    """Return the eight corners (D, 8, 3) [m] of boxes (D, 9): x y z w l h [m], yaw [rad], vx vy.

    Corners 0 to 3 are the bottom: front left, front right, rear right, rear left. Corners 4 to 7 are the top in the
    same order. The length is along the heading.
    """
    boxes = np.asarray(boxes, dtype=np.float64).reshape(-1, 9)
    along = np.array([1, 1, -1, -1, 1, 1, -1, -1])
    across = np.array([1, -1, -1, 1, 1, -1, -1, 1])
    up = np.array([-1, -1, -1, -1, 1, 1, 1, 1])
    width, length, height, yaw = boxes[:, 3:4], boxes[:, 4:5], boxes[:, 5:6], boxes[:, 6:7]
    forward, left = along * length / 2, across * width / 2
    return np.stack(
        [
            boxes[:, 0:1] + forward * np.cos(yaw) - left * np.sin(yaw),
            boxes[:, 1:2] + forward * np.sin(yaw) + left * np.cos(yaw),
            boxes[:, 2:3] + up * height / 2,
        ],
        axis=-1,
    )
