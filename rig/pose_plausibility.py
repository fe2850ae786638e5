"""How well camera poses fit a vehicle rig: the height, the level, the direction in the name, looking outward.

The costs order the likely causes of wrong extrinsics. They do not decide whether a pose is wrong: `extrinsics` does.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .camera_names import azimuth_from_name, difference_deg
from .optics import CameraPose

Array = NDArray[np.float64]

# Poses of cameras in most rigs. These limits are narrower than those of the checks in `extrinsics`, because a likely
# cause needs more evidence than a suspicion.
TYPICAL_HEIGHT_M = (0.2, 4.0)
TYPICAL_DISTANCE_M = 12.0
TYPICAL_ELEVATION_DEG = 25.0
TYPICAL_ROLL_DEG = 10.0

MEDIAN_HEIGHT_M = 1.6  # of cameras on cars; a factor of 1.6 more or less costs 1
HEIGHT_SPREAD = 0.47  # as a natural logarithm
SMALLEST_RIG_M = 0.1  # between the two cameras of a rig that are farthest apart, if they look in different directions
LARGEST_COST = 25.0  # of one property


@dataclass(frozen=True)
class RigContext:
    """What the other cameras of a rig say about a camera. None or NaN for unknown values.

    centre_m: (2,) the mean position in the ground plane.
    height_m: the median height.
    """

    centre_m: Array | None = None
    height_m: float | None = None

    @classmethod
    def of(cls, poses: Sequence[CameraPose]) -> "RigContext":
        """The context of a rig with these poses."""
        if len(poses) < 2:
            return cls()
        positions = np.array([pose.position_m for pose in poses])
        return cls(positions[:, :2].mean(axis=0), float(np.median(positions[:, 2])))


def is_typical(pose: CameraPose) -> bool:
    """Whether a camera pose is typical for vehicle rigs."""
    x, y, z = pose.position_m
    return (
        TYPICAL_HEIGHT_M[0] <= z <= TYPICAL_HEIGHT_M[1]
        and bool(np.hypot(x, y) <= TYPICAL_DISTANCE_M)
        and abs(pose.elevation_deg) <= TYPICAL_ELEVATION_DEG
        and not abs(pose.roll_deg) > TYPICAL_ROLL_DEG
    )


def rig_cost(poses: Mapping[str, CameraPose]) -> float:
    """The mean cost of the poses of a rig, by camera name. Below about 3, the rig is a usual one."""
    context = RigContext.of(list(poses.values()))
    costs = [pose_cost(name, pose, context) for name, pose in poses.items()]
    return float(np.mean(costs)) + _extent_cost(list(poses.values()))


def pose_cost(name: str, pose: CameraPose, context: RigContext) -> float:
    """The cost of one pose: 0 for the most usual one, above about 3 for an unusual one."""
    x, y, z = pose.position_m
    costs = [
        _excess(pose.elevation_deg, 15, 8),
        0.0 if np.isnan(pose.roll_deg) else _excess(pose.roll_deg, 4, 5),
        _excess(float(np.hypot(x, y)), 5, 3),
        (np.log(z / MEDIAN_HEIGHT_M) / HEIGHT_SPREAD) ** 2 if z > 0 else LARGEST_COST,
        0.0 if context.height_m is None else _excess(z - context.height_m, 0.7, 0.7),
    ]
    return float(sum(min(cost, LARGEST_COST) for cost in costs)) + direction_cost(name, pose, context)


def direction_cost(name: str, pose: CameraPose, context: RigContext) -> float:
    """The cost of a direction that does not fit the name, or leads across the vehicle."""
    named_deg = azimuth_from_name(name)
    cost = 0.0 if named_deg is None else _excess(difference_deg(named_deg, pose.azimuth_deg), 35, 25)
    if context.centre_m is not None:
        cost += _outward_cost(pose, context.centre_m)
    return min(cost, LARGEST_COST)


def _outward_cost(pose: CameraPose, centre_m: Array) -> float:
    """The cost of looking across the vehicle. Cameras near the centre may look in any direction."""
    offset = pose.position_m[:2] - centre_m
    if np.hypot(*offset) < 0.4:
        return 0.0
    outward_deg = float(np.degrees(np.arctan2(offset[1], offset[0])))
    return _excess(difference_deg(outward_deg, pose.azimuth_deg), 80, 30)


def _extent_cost(poses: Sequence[CameraPose]) -> float:
    """The cost of cameras in different directions at one place."""
    positions = np.array([pose.position_m for pose in poses])
    azimuths = [pose.azimuth_deg for pose in poses]
    extent_m = np.linalg.norm(positions[:, None] - positions, axis=-1).max()
    has_directions = max(difference_deg(azimuth, azimuths[0]) for azimuth in azimuths) > 30
    return LARGEST_COST if len(poses) > 2 and has_directions and extent_m < SMALLEST_RIG_M else 0.0


def _excess(value: float, free: float, unit: float) -> float:
    """The square of what exceeds `free` in absolute value, in units."""
    return (max(0.0, abs(value) - free) / unit) ** 2
