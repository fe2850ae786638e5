"""Poses of nuScenes tables: translations and quaternions, their checks, and their transforms."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .table import Place, row_error

LENGTH_TOLERANCE = 1e-2  # of a quaternion's length of 1
LARGEST_M = 1e9
LEAST_UPRIGHT = 0.1  # the z component of the vehicle's z axis

Array = NDArray[np.float64]


class Poses(NamedTuple):
    """P poses: translations (P, 3) [m] and rotations (P, 4), quaternions with w first."""

    translations: Array
    rotations: Array


def check_poses(path: Path, poses: Poses, place_of: Callable[[int], Place]) -> None:
    """Check that quaternions have length 1, and that positions are possible.

    place_of: returns the row number and the token of a pose.
    Raises InputError, naming them and the table `path`.
    """
    with np.errstate(over="ignore"):  # infinity is wrong too
        lengths = np.linalg.norm(poses.rotations, axis=1)
    wrong = np.flatnonzero(~(np.abs(lengths - 1) <= LENGTH_TOLERANCE))
    if len(wrong):
        message = f"expected a quaternion of length 1; got {lengths[wrong[0]]:.6g}"
        raise row_error(path, place_of(wrong[0]), message)
    wrong = np.flatnonzero((np.abs(poses.translations) > LARGEST_M).any(axis=1))
    if len(wrong):
        message = f"expected a translation of at most {LARGEST_M:g} m; got {poses.translations[wrong[0]].tolist()}"
        raise row_error(path, place_of(wrong[0]), message)


def check_upright(path: Path, poses: Poses, places: Sequence[Place]) -> None:
    """Check that the z axis of the vehicle points up.

    places: the row number and the token of each pose.
    Raises InputError, naming them and the table `path`.
    """
    heights = rotations_from_quaternions(poses.rotations)[:, 2, 2]
    wrong = np.flatnonzero(heights < LEAST_UPRIGHT)
    if len(wrong):
        raise row_error(
            path,
            places[wrong[0]],
            f"expected an upright vehicle; got the rotation {poses.rotations[wrong[0]].tolist()}. "
            "Is the quaternion written with w first?",
        )


def rigid_transforms(translations_m: Array, quaternions: Array) -> Array:
    """Return the transforms (..., 4, 4) of translations (..., 3) and quaternions (..., 4)."""
    transforms = np.zeros((*translations_m.shape[:-1], 4, 4))
    transforms[..., :3, :3] = rotations_from_quaternions(quaternions)
    transforms[..., :3, 3] = translations_m
    transforms[..., 3, 3] = 1.0
    return transforms


def rotations_from_quaternions(quaternions: Array) -> Array:
    """Return the rotations (..., 3, 3) of quaternions (..., 4), w first, of any length above zero."""
    w, x, y, z = np.moveaxis(quaternions / np.linalg.norm(quaternions, axis=-1, keepdims=True), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))
