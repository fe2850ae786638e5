"""The limits of possible calibrations, poses and times, and a check of many at once.

`validation.py` checks single frames with these limits and describes what is wrong.
"""

import numpy as np
from numpy.typing import NDArray

ORTHONORMAL_TOLERANCE = 2e-3  # accepts rotations that were written with three decimals
LARGEST = 1e9  # px or m: larger than any focal length and any coordinate on Earth
LATEST_S = 1e11

# Limits as multiples of the image's width or height. A focal length below 0.1 means a field of view above 157
# degrees, which is not a pinhole camera; above 60 it is below 1 degree. Cropping can move the principal point out of
# the image, but not by more than the size of another image.
SHORTEST_FOCAL, LONGEST_FOCAL = 0.1, 60
FARTHEST_CENTRE = 2

Array = NDArray[np.float64]


def are_rigid(transforms: Array) -> NDArray[np.bool_]:
    """Return for transforms (n, 4, 4) whether each is a rotation and a translation, of finite numbers."""
    rotations = transforms[:, :3, :3]
    with np.errstate(over="ignore", invalid="ignore"):  # the comparisons below are false for the results
        deviations = np.abs(rotations @ np.swapaxes(rotations, 1, 2) - np.eye(3)).max(axis=(1, 2))
        determinants = np.linalg.det(rotations)
    is_rotation = (deviations <= ORTHONORMAL_TOLERANCE) & (determinants > 0)
    has_last_row = (transforms[:, 3] == [0, 0, 0, 1]).all(axis=1)
    return is_rotation & has_last_row & (np.abs(transforms) <= LARGEST).all(axis=(1, 2))


def are_intrinsics_possible(intrinsics_px: Array, sizes_px: NDArray) -> NDArray[np.bool_]:
    """Return for intrinsics (n, 3, 3) and image sizes (n, 2), width and height, whether each is a pinhole camera's."""
    lower = np.tril_indices(3, -1)
    is_upper = (intrinsics_px[:, *lower] == 0).all(axis=1) & (intrinsics_px[:, 2, 2] == 1)
    focal = np.diagonal(intrinsics_px, axis1=1, axis2=2)[:, :2]
    with np.errstate(divide="ignore", invalid="ignore"):  # a size of zero is not possible
        relative_focal, centre = focal / sizes_px, intrinsics_px[:, :2, 2] / sizes_px
    is_in_proportion = (relative_focal >= SHORTEST_FOCAL) & (relative_focal <= LONGEST_FOCAL)
    is_in_proportion &= (np.abs(centre - 0.5) <= FARTHEST_CENTRE) & (sizes_px >= 1)
    return is_upper & is_in_proportion.all(axis=1) & (np.abs(intrinsics_px) <= LARGEST).all(axis=(1, 2))
