"""Annotated boxes of nuScenes: velocities from the neighbouring key frames, and boxes in the ego frame."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# As in `NuScenes.box_velocity` of nuscenes-devkit 1.2.0.
LONGEST_STEP_S = 1.5


def box_velocities(
    centres_m: Array, times_s: Array, previous: NDArray[np.int64], following: NDArray[np.int64]
) -> Array:
    """Return the velocities (A, 2) [m/s] of annotations in x and y of the global frame; NaN where unknown.

    A velocity is the difference of the positions in the previous and the following annotation of the same object. The
    annotation itself replaces a neighbour that does not exist. A velocity is unknown without any neighbour, and if the
    two are more than 1.5 s apart, or 3 s with both neighbours.

    centres_m: (A, 3) in the global frame.
    times_s: (A,), of the key frames.
    previous, following: (A,) row numbers of the neighbours, or -1.

    Source: `NuScenes.box_velocity` of nuscenes-devkit 1.2.0. There the velocity at a step of 0 s is infinite.
    """
    rows = np.arange(len(centres_m))
    has_previous, has_following = previous >= 0, following >= 0
    first, last = np.where(has_previous, previous, rows), np.where(has_following, following, rows)
    steps_s = times_s[last] - times_s[first]
    longest_s = np.where(has_previous & has_following, 2 * LONGEST_STEP_S, LONGEST_STEP_S)
    is_known = (has_previous | has_following) & (steps_s <= longest_s) & (steps_s != 0)
    velocities = np.full((len(centres_m), 2), np.nan)
    moves_m = (centres_m[last] - centres_m[first])[is_known, :2]
    velocities[is_known] = moves_m / steps_s[is_known, None]
    return velocities


def boxes_in_ego(
    centres_m: Array, sizes_m: Array, rotations: Array, velocities_m_s: Array, global_T_ego: Array
) -> Array:
    """Return boxes (A, 9) in the ego frame: x y z w l h yaw vx vy.

    centres_m: (A, 3) in the global frame. sizes_m: (A, 3), width, length, height.
    rotations: (A, 3, 3) from the box (length along x) to the global frame.
    velocities_m_s: (A, 2) in x and y of the global frame.
    global_T_ego: (A, 4, 4), of an upright vehicle.

    nuScenes annotates headings and velocities in the plane of the global x and y. A pitched ego vehicle has another
    plane. The yaw and the velocity returned here are those whose direction, rotated into the global frame, has
    exactly the annotated x and y. So the benchmark gets its own values back.
    """
    global_R_ego = global_T_ego[:, :3, :3]
    centres = np.einsum("aji,aj->ai", global_R_ego, centres_m - global_T_ego[:, :3, 3])
    ego_M_global = np.linalg.inv(global_R_ego[:, :2, :2])
    headings = np.einsum("aij,aj->ai", ego_M_global, rotations[:, :2, 0])
    velocities = np.einsum("aij,aj->ai", ego_M_global, velocities_m_s)
    yaws = np.arctan2(headings[:, 1], headings[:, 0])
    return np.concatenate([centres, sizes_m, yaws[:, None], velocities], axis=1)
