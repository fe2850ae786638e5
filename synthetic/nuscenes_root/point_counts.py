"""The number of lidar and radar points in a box. No point cloud is simulated: counts follow from size and distance."""

import numpy as np
from numpy.typing import NDArray

LIDAR_POINT_SR = 1.34e-4  # solid angle per point of 32 beams, 1.33 degrees apart, and 0.33 degrees in azimuth
HIT_SHARE = 0.5  # of the beams towards a box; glass and gaps return nothing
RADAR_RANGE_M = 60.0

Rng = np.random.Generator


def count_lidar_points(size_m: NDArray[np.float64], distance_m: float, visible_share: float, rng: Rng) -> int:
    """The number of lidar points in a box of a size (3,), w l h [m], at a distance from the ego."""
    area_m2 = float(np.sqrt(size_m[0] * size_m[1]) * size_m[2])
    beams = area_m2 / max(distance_m, 1.0) ** 2 / LIDAR_POINT_SR
    return int(rng.poisson(HIT_SHARE * visible_share * beams))


def count_radar_points(category: str, distance_m: float, visible_share: float, rng: Rng) -> int:
    """The number of radar points in a box at a distance from the ego. Only vehicles reflect radar well."""
    reflects = category.startswith("vehicle.") and distance_m < RADAR_RANGE_M
    return int(rng.poisson(2.0 * visible_share)) if reflects else 0
