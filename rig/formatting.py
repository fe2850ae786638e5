"""Angles in words."""

from collections.abc import Sequence

import numpy as np

from .coverage import NEAR_M, Sector


def describe_elevation(elevation_deg: float) -> str:
    """An angle above the horizontal."""
    return f"{abs(elevation_deg):.1f} degrees {'up' if elevation_deg >= 0 else 'down'}"


def describe_roll(roll_deg: float) -> str:
    """An angle about the optical axis, after a comma; nothing where there is none."""
    return "" if np.isnan(roll_deg) else f", rolled by {round(roll_deg, 1) + 0.0:.1f} degrees"  # + 0.0: no minus zero


def describe_azimuth(azimuth_deg: float) -> str:
    """A direction in the ground plane: 0 ahead, positive to the left."""
    if abs(azimuth_deg) < 0.05:
        return "straight ahead"
    return f"{abs(azimuth_deg):.1f} degrees to the {'left' if azimuth_deg > 0 else 'right'}"


def describe_sectors(sectors: Sequence[Sector]) -> str:
    """The directions in which most of the ground is not seen."""
    if not sectors:
        return f"no blind direction: at least half of the ground beyond {NEAR_M:g} m is seen in each"
    angles = ", ".join(f"{sector.start_deg:.0f} to {sector.end_deg:.0f}" for sector in sectors)
    return (
        f"blind directions, with less than half of the ground beyond {NEAR_M:g} m seen, degrees from ahead to the "
        f"left: {angles}"
    )
