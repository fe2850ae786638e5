"""Likely causes of wrong extrinsics: of one camera, and of all cameras of a rig together.

A mistake explains extrinsics if undoing it gives a typical camera pose. Of several, the one with the most usual rig is
the most likely.
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from .extrinsic_mistakes import WRONG_QUATERNION_ORDER, Mistake, extrinsic_mistakes
from .optics import CameraPose, camera_pose
from .pose_plausibility import MEDIAN_HEIGHT_M, RigContext, direction_cost, is_typical, pose_cost, rig_cost

Array = NDArray[np.float64]

LARGEST_GAP = 0.8  # a second cause is named only if its cost is larger than that of the first by at most this
LARGEST_EXPLAINED_COST = 3.0  # a rig with a larger mean cost after the correction is not explained by the mistake
LEAST_ODD_GAIN = 5.0  # of a cause of a pose that is possible
LEAST_GAIN = 2.0  # of a cause of a whole rig, compared with the rig as it is
WRONG_ORIGIN_DOUBT = 1.5  # a shift of the origin explains wrong heights of any kind
LARGEST_HEIGHT_SPREAD_M = 1.5  # between cameras that share an origin at a wrong height
LOW_M = 0.8  # usual cameras are higher
TOO_LOW_M = 0.2  # no camera of a vehicle is lower above the road

DEGREES_AS_RADIANS = (
    "angles in degrees were read as radians, or Euler angles or quaternions have another order: "
    "the positions fit a rig, the directions do not"
)


def likely_causes(camera_T_ego: Array, name: str = "", context: RigContext | None = None) -> list[str]:
    """The mistakes that explain the extrinsics (4, 4) of one camera, the most likely first.

    camera_T_ego: (4, 4), a rigid transform.
    name: the camera's name, which may say its direction.
    context: of the other cameras.
    """
    context = context or RigContext()
    costs: dict[str, float] = {}
    for mistake in extrinsic_mistakes():
        corrected = None if mistake.is_shared else mistake.undo(camera_T_ego)
        if corrected is None or not is_typical(pose := camera_pose(corrected)):
            continue
        cost = pose_cost(name, pose, context) + mistake.doubt
        costs[mistake.cause] = min(cost, costs.get(mistake.cause, np.inf))
    return _most_likely(costs)


def cause_of_odd_pose(camera_T_ego: Array, name: str, context: RigContext) -> str | None:
    """The mistake that explains a pose that is possible, but odd beside the other cameras; None for a usual pose."""
    if context.height_m is None:
        return None
    given = pose_cost(name, camera_pose(camera_T_ego), context)
    costs = {
        mistake.cause: pose_cost(name, camera_pose(corrected), context)
        for mistake in extrinsic_mistakes()
        if given > LEAST_ODD_GAIN
        and not (mistake.doubt or mistake.is_shared)
        and (corrected := mistake.undo(camera_T_ego)) is not None
    }
    best = min(costs, key=lambda cause: costs[cause], default=None)
    return best if best is not None and costs[best] < given - LEAST_ODD_GAIN else None


def shared_causes(cameras: Mapping[str, Array]) -> list[str]:
    """The mistakes that explain the extrinsics of all cameras of a rig at once, the most likely first.

    cameras: the `camera_T_ego` (4, 4) of at least two cameras by name, all rigid transforms.
    """
    given = {name: camera_pose(camera_T_ego) for name, camera_T_ego in cameras.items()}
    costs: dict[str, float] = {}
    for mistake in extrinsic_mistakes():
        poses = _correct_all(cameras, mistake)
        if poses is not None and all(map(is_typical, poses.values())):
            cost = rig_cost(poses) + mistake.doubt
            costs[mistake.cause] = min(cost, costs.get(mistake.cause, np.inf))
    origin = _origin_height(given)
    if origin is not None:
        cause, cost = origin
        costs[cause] = cost
    largest = min(LARGEST_EXPLAINED_COST, rig_cost(given) - LEAST_GAIN)
    causes = _most_likely({cause: cost for cause, cost in costs.items() if cost <= largest})
    if not causes and _has_only_wrong_directions(given):
        return [DEGREES_AS_RADIANS]
    return causes


def _correct_all(cameras: Mapping[str, Array], mistake: Mistake) -> dict[str, CameraPose] | None:
    """The poses without a mistake; None if one camera cannot have it."""
    poses = {}
    for name, camera_T_ego in cameras.items():
        corrected = mistake.undo(camera_T_ego)
        if corrected is None:
            return None
        poses[name] = camera_pose(corrected)
    return poses


def _most_likely(costs: Mapping[str, float]) -> list[str]:
    """The causes with about the smallest cost, the smallest first."""
    ordered = sorted(costs, key=lambda cause: costs[cause])
    likely = [cause for cause in ordered if costs[cause] <= costs[ordered[0]] + LARGEST_GAP]
    # A wrong quaternion order explains nearly every pose of a single camera, so it is never a second choice.
    return [cause for cause in likely if cause != WRONG_QUATERNION_ORDER or cause == likely[0]]


def _origin_height(poses: Mapping[str, CameraPose]) -> tuple[str, float] | None:
    """The cause that the ego origin is above the road, with its cost; None if the cameras have no such heights."""
    heights = np.array([pose.position_m[2] for pose in poses.values()])
    if heights.min() > TOO_LOW_M or np.median(heights) > LOW_M or np.ptp(heights) > LARGEST_HEIGHT_SPREAD_M:
        return None
    rise_m = MEDIAN_HEIGHT_M - float(np.median(heights))
    raised = {name: _raise(pose, rise_m) for name, pose in poses.items()}
    if not all(map(is_typical, raised.values())):
        return None
    place = "at the cameras" if abs(np.median(heights)) <= TOO_LOW_M else "on the roof or at a sensor"
    cause = f"the ego origin is {place}, about {rise_m:.1f} m above the road, instead of on the road"
    return cause, rig_cost(raised) + WRONG_ORIGIN_DOUBT


def _raise(pose: CameraPose, rise_m: float) -> CameraPose:
    return CameraPose(pose.position_m + np.array([0, 0, rise_m]), pose.azimuth_deg, pose.elevation_deg, pose.roll_deg)


def _has_only_wrong_directions(poses: Mapping[str, CameraPose]) -> bool:
    """Whether the positions of a rig are usual ones, but cameras are rolled or look across the vehicle."""
    context = RigContext.of(list(poses.values()))
    level = [CameraPose(pose.position_m, np.nan, 0.0, 0.0) for pose in poses.values()]
    is_usual = all(pose_cost("", pose, RigContext(None, context.height_m)) < 3 for pose in level)
    wrong = [abs(pose.roll_deg) > 30 or direction_cost(name, pose, context) > 2 for name, pose in poses.items()]
    return is_usual and sum(wrong) >= max(2, len(wrong) / 3)
