"""Steps of the vehicle between consecutive frames."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Frame
from ..runtime.geometry import rotation_angle

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MotionStep:
    """The motion from frame `start` to the next frame `end` of the same scene.

    elapsed_s: time from start to end; not positive if frames are out of order.
    before, after: `global_T_ego` (4, 4) of the two frames.
    """

    start: int
    end: int
    elapsed_s: float
    before: Array
    after: Array

    @classmethod
    def between(cls, start: int, end: int, before: Frame, after: Frame) -> "MotionStep":
        """The step from one frame to the next."""
        elapsed_s = float(after.timestamp_s) - float(before.timestamp_s)
        return cls(start, end, elapsed_s, before.global_T_ego, after.global_T_ego)

    @property
    def distance_m(self) -> float:
        """The distance between the two positions."""
        return distance_between_m(self.before, self.after)

    @property
    def turn_rad(self) -> float:
        """The angle between the two orientations."""
        return turn_between_rad(self.before, self.after)

    @property
    def speed_m_s(self) -> float:
        """The mean speed of the step; NaN if `elapsed_s` is not positive."""
        return self.distance_m / self.elapsed_s if self.elapsed_s > 0 else np.nan

    @property
    def turn_rad_s(self) -> float:
        """The mean turn rate of the step; NaN if `elapsed_s` is not positive."""
        return self.turn_rad / self.elapsed_s if self.elapsed_s > 0 else np.nan

    @property
    def heading_rad(self) -> float:
        """The heading of the first pose: the direction of the ego x axis in the global x-y plane."""
        return float(np.arctan2(self.before[1, 0], self.before[0, 0]))

    @property
    def course_rad(self) -> float:
        """The direction of the motion in the global x-y plane."""
        x, y, _ = self.after[:3, 3] - self.before[:3, 3]
        return float(np.arctan2(y, x))

    def displacement_m(self, correct: Callable[[Array], Array] = lambda pose: pose) -> Array:
        """The displacement (3,) [m] in the ego frame: the mean of its values in the first and the second ego frame.

        correct: a change of both poses.
        """
        before, after = correct(self.before), correct(self.after)
        displacement = after[:3, 3] - before[:3, 3]
        return np.asarray((before[:3, :3].T @ displacement + after[:3, :3].T @ displacement) / 2, np.float64)


def median_slip_deg(steps: Sequence[MotionStep], correct: Callable[[Array], Array] = lambda pose: pose) -> float:
    """The median angle [deg] between the motion and the ego x axis, forward or backward.

    correct: a change of all poses.
    """
    displacements = np.array([step.displacement_m(correct) for step in steps])
    across, along = np.hypot(displacements[:, 1], displacements[:, 2]), np.abs(displacements[:, 0])
    return float(np.median(np.degrees(np.arctan2(across, along))))


def distance_between_m(before: Array, after: Array) -> float:
    """The distance between the positions of two poses `global_T_ego` (4, 4)."""
    return float(np.linalg.norm(after[:3, 3] - before[:3, 3]))


def turn_between_rad(before: Array, after: Array) -> float:
    """The angle between the orientations of two poses `global_T_ego` (4, 4)."""
    return rotation_angle(before[:3, :3].T @ after[:3, :3])
