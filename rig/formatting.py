"""Positions, angles and blind sectors as text."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from .blind_sectors import EXCLUDED_RADIUS_M, Sector


def describe_position(position_m: NDArray[np.float64]) -> str:
    """A position (3,) [m], for example "x 1.50, y 0.00, z 1.50 m"."""
    x, y, z = np.round(position_m, 2) + 0.0  # adding 0.0 turns -0.0 into 0.0
    return f"x {x:.2f}, y {y:.2f}, z {z:.2f} m"


def describe_elevation(elevation_deg: float) -> str:
    """An angle above the horizontal, for example "12.0 degrees up"."""
    return f"{abs(elevation_deg):.1f} degrees {'up' if elevation_deg >= 0 else 'down'}"


def describe_roll(roll_deg: float) -> str:
    """A roll angle with a leading comma, to append to an elevation; empty for NaN."""
    return "" if np.isnan(roll_deg) else f", rolled by {round(roll_deg, 1) + 0.0:.1f} degrees"


def describe_azimuth(azimuth_deg: float) -> str:
    """A direction in the ground plane: 0 is straight ahead, positive is to the left."""
    if abs(azimuth_deg) < 0.05:
        return "straight ahead"
    return f"{abs(azimuth_deg):.1f} degrees to the {'left' if azimuth_deg > 0 else 'right'}"


def describe_sectors(sectors: Sequence[Sector]) -> str:
    """The blind sectors of a rig, or a statement that there is no blind sector."""
    if not sectors:
        return (
            f"no blind sector: in every direction at least half of the ground beyond {EXCLUDED_RADIUS_M:g} m is visible"
        )
    angles = ", ".join(f"{sector.start_deg:.0f} to {sector.end_deg:.0f}" for sector in sectors)
    return (
        f"blind sectors, with less than half of the ground beyond {EXCLUDED_RADIUS_M:g} m visible, in degrees to the "
        f"left of straight ahead: {angles}"
    )
