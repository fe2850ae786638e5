"""Checks of the times and ego poses of a recording: units, order, speed, turn rate and direction of motion."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError
from ..runtime.frame import Frame
from ..runtime.geometry import inverse, rotation_angle
from ..runtime.validation import check_frame_header
from .findings import Finding, Verdict, finding_from_error, merge_findings
from .requirements import RigRequirements

Array = NDArray[np.float64]

# The slip is the angle between the motion and the ego x axis. A vehicle moves along its heading, to a few degrees.
LARGEST_SLIP_DEG = 20.0
IMPOSSIBLE_SLIP_DEG = 45.0
LEAST_STEPS = 3  # with an impossible slip; fewer steps are only suspect
EXPLAINED_SLIP_DEG = 10.0  # a mistake explains the slip if undoing it leaves less than this
LEAST_STEP_M = 0.5  # the direction of a shorter step is not reliable
LEAST_DISTANCE_M = 5.0  # in total: the position of a parked vehicle drifts, or jumps once, in any direction
SHORTEST_STEP_S = 0.002  # no vehicle camera takes 500 frames per second
UNITS_PER_SECOND = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}

INVERTED = "global_T_ego is inverted: the matrix is ego_T_global."
CORRECT_TIME = "Give timestamp_s in seconds, and the frames of a scene in order of time."
CORRECT_CAMERA_COUNT = "Remove cameras, or export the bundle for more of them."
ADD_CAMERAS = "Add the cameras, with null as the image of a lost camera, or remove the frame."
CORRECT_POSE = (
    "Correct global_T_ego: it maps points of the ego frame (x forward, y left, z up) to the global frame, in metres."
)


@dataclass(frozen=True)
class MotionStep:
    """The motion from frame `start` to the next frame `end` of the same scene.

    elapsed_s: time from start to end; not positive if frames are out of order.
    distance_m, turn_rad: between the two poses.
    displacement_m: (3,) in the ego frame.
    displacement_if_inverted_m: (3,) the same, if the poses were ego_T_global.
    """

    start: int
    end: int
    elapsed_s: float
    distance_m: float
    turn_rad: float
    displacement_m: Array
    displacement_if_inverted_m: Array

    @property
    def speed_m_s(self) -> float:
        """The mean speed of the step; NaN if `elapsed_s` is not positive."""
        return self.distance_m / self.elapsed_s if self.elapsed_s > 0 else np.nan

    @property
    def turn_rad_s(self) -> float:
        """The mean turn rate of the step; NaN if `elapsed_s` is not positive."""
        return self.turn_rad / self.elapsed_s if self.elapsed_s > 0 else np.nan


def frame_findings(frames: list[Frame], requirements: RigRequirements) -> list[Finding]:
    """Findings about single frames: numbers of cameras, times and poses that the pipeline rejects."""
    return merge_findings(
        (index, finding) for index, frame in enumerate(frames) for finding in _invalid_header(frame, requirements)
    )


def step_findings(steps: list[MotionStep], requirements: RigRequirements) -> list[Finding]:
    """Findings about consecutive frames with valid times and poses."""
    if not steps:
        return []
    findings = (
        _order_finding(steps),
        _interval_finding(steps, requirements),
        _speed_finding(steps, requirements),
        _turn_finding(steps, requirements),
        _slip_finding(steps, requirements),
    )
    return [finding for finding in findings if finding is not None]


def steps_between(frames: list[Frame], requirements: RigRequirements) -> list[MotionStep]:
    """The steps between consecutive frames of the same scene. Frames that the pipeline rejects are skipped."""
    valid = [(index, frame) for index, frame in enumerate(frames) if not any(_invalid_header(frame, requirements))]
    return [
        _step(start, end, before, after)
        for (start, before), (end, after) in pairwise(valid)
        if before.scene == after.scene
    ]


def _step(start: int, end: int, before: Frame, after: Frame) -> MotionStep:
    return MotionStep(
        start=start,
        end=end,
        elapsed_s=float(after.timestamp_s) - float(before.timestamp_s),
        distance_m=float(np.linalg.norm(after.global_T_ego[:3, 3] - before.global_T_ego[:3, 3])),
        turn_rad=rotation_angle(before.global_T_ego[:3, :3].T @ after.global_T_ego[:3, :3]),
        displacement_m=_displacement(before.global_T_ego, after.global_T_ego),
        displacement_if_inverted_m=_displacement(inverse(before.global_T_ego), inverse(after.global_T_ego)),
    )


def _displacement(before: Array, after: Array) -> Array:
    """The displacement (3,) [m] between two poses: the mean of its values in the first and in the second ego frame."""
    displacement = after[:3, 3] - before[:3, 3]
    return (before[:3, :3].T @ displacement + after[:3, :3].T @ displacement) / 2


def _invalid_header(frame: Frame, requirements: RigRequirements) -> Iterator[Finding]:
    """Yield a finding if the pipeline rejects the number of cameras, the time or the pose of a frame."""
    if not frame.cameras:
        cause = "Neither the frame nor the scene defines a camera."
        yield Finding("cameras", Verdict.BROKEN, "at least one camera", "no camera", cause, ADD_CAMERAS)
        return
    try:
        check_frame_header(frame, requirements.num_cameras or len(frame.cameras))
    except InputError as error:
        subject = str(error).split(":")[0]
        causes = {"timestamp_s": _time_unit_cause(frame.timestamp_s)}
        remedies = {"timestamp_s": CORRECT_TIME, "global_T_ego": CORRECT_POSE, "cameras": CORRECT_CAMERA_COUNT}
        yield finding_from_error(subject, error, causes.get(subject, ""), remedies.get(subject, ""))


def _time_unit_cause(timestamp_s: float) -> str:
    """A sentence with the unit in which a number is a Unix time between 1973 and 2286; empty without such a unit."""
    for unit, per_second in UNITS_PER_SECOND.items():
        if 1e8 <= timestamp_s / per_second < 1e10:
            return f"The time is in {unit}."
    return ""


def _order_finding(steps: list[MotionStep]) -> Finding | None:
    """A finding if times do not increase."""
    backward = [step for step in steps if step.elapsed_s <= 0]
    if not backward:
        return None
    return Finding(
        "time order",
        Verdict.BROKEN,
        "times that increase from frame to frame of a scene",
        f"{backward[0].elapsed_s:.6g} s from frame {backward[0].start} to frame {backward[0].end}",
        "Frames are out of order or repeated, or times were rounded to float32.",
        CORRECT_TIME,
        backward[0].end,
        len(backward),
    )


def _interval_finding(steps: list[MotionStep], requirements: RigRequirements) -> Finding | None:
    """A finding if the median time between frames is implausible."""
    elapsed_s = float(np.median([step.elapsed_s for step in steps]))
    largest_s = requirements.largest_time_delta_s
    if elapsed_s <= 0 or SHORTEST_STEP_S <= elapsed_s <= largest_s:
        return None
    units = [unit for unit, factor in UNITS_PER_SECOND.items() if SHORTEST_STEP_S <= elapsed_s / factor <= largest_s]
    if units:
        cause = f"The times are in {units[0]}."
    elif elapsed_s < SHORTEST_STEP_S:
        cause = "The times are in a larger unit than seconds."
    else:
        cause = "Too many frames are missing. The pipeline resets its history at such gaps."
    return Finding(
        "time between frames",
        Verdict.SUSPECT,
        f"{SHORTEST_STEP_S:g} to {largest_s:g} s",
        f"a median of {elapsed_s:.6g} s",
        cause,
        CORRECT_TIME,
        steps[0].end,
        len(steps),
    )


def _speed_finding(steps: list[MotionStep], requirements: RigRequirements) -> Finding | None:
    """A finding if steps are faster than a vehicle. It is BROKEN if they are the majority."""
    fast = [step for step in steps if step.speed_m_s > requirements.largest_speed_m_s]
    if not fast:
        return None
    first, is_usual = fast[0], len(fast) > len(steps) / 2
    if not is_usual:
        cause = "There is a scene cut, or the position jumps. The pipeline resets its history there."
    elif _is_explained_by_inversion(fast):
        cause = INVERTED
    else:
        cause = "Positions are not in metres but in millimetres or degrees, or times are not in seconds."
    return Finding(
        "speed",
        Verdict.BROKEN if is_usual else Verdict.SUSPECT,
        f"at most {requirements.largest_speed_m_s:g} m/s",
        f"a median of {np.median([step.speed_m_s for step in fast]):.4g} m/s in {len(fast)} of {len(steps)} steps, "
        f"the first from frame {first.start} to frame {first.end}",
        cause,
        CORRECT_POSE,
        first.end,
        len(fast),
    )


def _is_explained_by_inversion(fast: list[MotionStep]) -> bool:
    """Whether inverting the poses reduces the median displacement to less than a tenth."""
    inverted_m = _median_m([step.displacement_if_inverted_m for step in fast])
    return inverted_m < _median_m([step.displacement_m for step in fast]) / 10


def _turn_finding(steps: list[MotionStep], requirements: RigRequirements) -> Finding | None:
    """A finding if steps turn faster than a vehicle. It is BROKEN if they are the majority."""
    turning = [step for step in steps if step.turn_rad_s > requirements.largest_turn_rad_s]
    if not turning:
        return None
    first, is_usual = turning[0], len(turning) > len(steps) / 2
    cause = "There is a scene cut, or the heading jumps. The pipeline resets its history there."
    if is_usual:
        cause = "Headings flip, or degrees were used as radians. The pipeline resets its history at each such turn."
    return Finding(
        "turn rate",
        Verdict.BROKEN if is_usual else Verdict.SUSPECT,
        f"at most {np.degrees(requirements.largest_turn_rad_s):g} degrees per second",
        f"{np.degrees(first.turn_rad):.0f} degrees in {first.elapsed_s:.3g} s, from frame {first.start} to frame "
        f"{first.end}",
        cause,
        CORRECT_POSE,
        first.end,
        len(turning),
    )


def _slip_finding(steps: list[MotionStep], requirements: RigRequirements) -> Finding | None:
    """A finding if the vehicle does not move along its heading.

    Steps with an excessive speed or turn rate are left out. They have other findings, and their direction is arbitrary.
    """
    moving = [
        step
        for step in steps
        if np.hypot(*step.displacement_m[:2]) >= LEAST_STEP_M
        and step.speed_m_s <= requirements.largest_speed_m_s
        and step.turn_rad_s <= requirements.largest_turn_rad_s
    ]
    if sum(step.distance_m for step in moving) < LEAST_DISTANCE_M:
        return None
    slip_deg = _median_slip_deg([step.displacement_m for step in moving])
    if slip_deg <= LARGEST_SLIP_DEG:
        return None
    return Finding(
        "direction of motion",
        Verdict.BROKEN if slip_deg > IMPOSSIBLE_SLIP_DEG and len(moving) >= LEAST_STEPS else Verdict.SUSPECT,
        f"motion along the ego x axis, within {LARGEST_SLIP_DEG:g} degrees",
        f"a median angle of {slip_deg:.0f} degrees to it",
        _slip_cause(moving),
        CORRECT_POSE,
        moving[0].end,
        len(moving),
    )


def _slip_cause(moving: list[MotionStep]) -> str:
    causes = []
    if _median_slip_deg([step.displacement_if_inverted_m for step in moving]) < EXPLAINED_SLIP_DEG:
        causes.append(INVERTED)
    if _median_slip_deg([step.displacement_m[[1, 0, 2]] for step in moving]) < EXPLAINED_SLIP_DEG:
        causes.append("The ego frame has y forward instead of x, or its heading is measured from another axis.")
    return " Or: ".join(causes) or "The heading in the poses is wrong."


def _median_m(displacements: list[Array]) -> float:
    """The median length [m] of displacements (3,)."""
    return float(np.median(np.linalg.norm(displacements, axis=-1)))


def _median_slip_deg(displacements: list[Array]) -> float:
    """The median angle [deg] between displacements (3,) and the x axis, forward or backward, in the ground plane."""
    return float(np.median([np.degrees(np.arctan2(abs(each[1]), abs(each[0]))) for each in displacements]))
