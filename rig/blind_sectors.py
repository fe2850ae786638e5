"""Blind sectors of a rig: directions in which its cameras see less than half of the ground."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..runtime.bundle.manifest import PerceptionRange
from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.frame import Camera
from .coverage import GROUND_M, Mask, is_visible

SECTOR_DEG = 1.0
RANGE_STEP_M = 1.0
EXCLUDED_RADIUS_M = 5.0  # nearer ground does not count: no rig sees all of it, because part of it is below the cameras


class Sector(NamedTuple):
    """A range of directions in the ground plane, counter-clockwise from start to end: 0 is forward, 90 is left.

    start_deg is in [0, 360); end_deg may exceed 360.
    """

    start_deg: float
    end_deg: float


def find_blind_sectors(
    cameras: Mapping[str, Camera], perception: PerceptionRange, preprocessing: Preprocessing | None
) -> list[Sector]:
    """The directions from the ego origin in which less than half of the ground is visible, at 1 degree resolution.

    Only ground within the perception range and beyond `EXCLUDED_RADIUS_M` counts. A direction without such ground is
    not blind.

    cameras: by name, with usable calibrations.
    preprocessing: parts of an image that it crops do not count as visible; None for whole images.
    """
    azimuths = np.radians(np.arange(0, 360, SECTOR_DEG) + SECTOR_DEG / 2)
    lower, upper = np.array(perception.lower_m[:2]), np.array(perception.upper_m[:2])
    distances = np.arange(
        EXCLUDED_RADIUS_M + RANGE_STEP_M / 2, np.hypot(*np.maximum(abs(lower), abs(upper))), RANGE_STEP_M
    )
    directions = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros_like(azimuths)], axis=-1)
    points = directions[:, None] * distances[:, None] + (0, 0, GROUND_M)
    is_in_range: Mask = np.all((points[..., :2] >= lower) & (points[..., :2] <= upper), axis=-1)
    is_seen = np.zeros_like(is_in_range)
    for camera in cameras.values():
        is_seen |= is_visible(camera, points, preprocessing)
    is_blind: Mask = 2 * np.sum(is_in_range & is_seen, axis=1) < np.sum(is_in_range, axis=1)
    return _join_sectors(is_blind)


def _join_sectors(is_blind: Mask) -> list[Sector]:
    """Join neighbouring blind degrees of a full circle, also across 0."""
    if is_blind.all():
        return [Sector(0.0, 360.0)]
    starts = np.flatnonzero(is_blind & ~np.roll(is_blind, 1))
    ends = np.flatnonzero(is_blind & ~np.roll(is_blind, -1)) + 1
    if len(ends) and ends[0] <= starts[0]:  # the last sector crosses 0: its end comes first
        ends = np.roll(ends, -1)
        ends[-1] += len(is_blind)
    return [Sector(float(start), float(end)) for start, end in zip(starts * SECTOR_DEG, ends * SECTOR_DEG, strict=True)]
