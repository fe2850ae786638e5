"""Checks of the times and ego poses of a recording: units, order, speed, turn rate and direction of motion."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError
from ..runtime.frame import Frame
from ..runtime.validation import check_frame_header
from .findings import Finding, NotJudged, Verdict, finding_from_error, merge_findings
from .motion_steps import MotionStep, median_slip_deg
from .pose_mistakes import large_unit, slip_cause, speed_cause, turn_cause
from .requirements import RigRequirements

# The slip is the angle between the motion and the ego x axis. A vehicle moves along its heading, to a few degrees.
LARGEST_SLIP_DEG = 20.0
IMPOSSIBLE_SLIP_DEG = 45.0
LEAST_STEPS = 3  # with an impossible slip; fewer steps are only suspect
LEAST_STEP_M = 0.5  # the direction of a shorter step is not reliable
LEAST_DISTANCE_M = 5.0  # in total: the position of a parked vehicle drifts, or jumps once, in any direction
SHORTEST_STEP_S = 0.002  # no vehicle camera takes 500 frames per second
LONGEST_STEP_S = 10.0  # a rig that takes frames for a detector is faster
UNIX_TIMES_S = (1e8, 1e10)  # from 1973 to 2286
LONGEST_UNIX_STEP_S = 3600.0  # times that may be Unix times in seconds are in another unit if frames are farther apart
LEAST_TINY_STEPS = 6  # that lead in one direction, before the unit of the positions is doubted
LEAST_STRAIGHTNESS = 0.9  # of these: distance from the first to the last position, compared with the path
UNITS_PER_SECOND = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}

SHORT_DRIVE, NO_STEPS = "direction of motion", "times and poses"  # checks that may be impossible
MOTION_CHECKS = (SHORT_DRIVE, NO_STEPS)
CORRECT_TIME = "Give timestamp_s in seconds, and the frames of a scene in order of time."
CORRECT_CAMERA_COUNT = "Remove cameras, or export the bundle for more of them."
ADD_CAMERAS = "Add the cameras, with null as the image of a lost camera, or remove the frame."
CORRECT_POSE = (
    "Correct global_T_ego: it maps points of the ego frame (x forward, y left, z up) to the global frame, in metres."
)


def frame_findings(frames: list[Frame], requirements: RigRequirements) -> list[Finding]:
    """Findings about single frames: numbers of cameras, times and poses that the pipeline rejects."""
    return merge_findings(
        (index, finding) for index, frame in enumerate(frames) for finding in _invalid_header(frame, requirements)
    )


def step_findings(steps: list[MotionStep], requirements: RigRequirements, first_time_s: float = 0.0) -> list[Finding]:
    """Findings about consecutive frames with valid times and poses. first_time_s: of the first frame."""
    if not steps:
        return []
    findings = (
        _order_finding(steps),
        _interval_finding(steps, requirements, first_time_s),
        _speed_finding(steps, requirements),
        _unit_finding(steps),
        _turn_finding(steps, requirements),
        _slip_finding(steps, requirements),
    )
    return [finding for finding in findings if finding is not None]


def steps_between(frames: list[Frame], requirements: RigRequirements) -> list[MotionStep]:
    """The steps between consecutive frames of the same scene. Frames that the pipeline rejects are skipped."""
    valid = [(index, frame) for index, frame in enumerate(frames) if is_valid_header(frame, requirements)]
    return [
        MotionStep.between(start, end, before, after)
        for (start, before), (end, after) in pairwise(valid)
        if before.scene == after.scene
    ]


def is_valid_header(frame: Frame, requirements: RigRequirements) -> bool:
    """Whether the pipeline accepts the number of cameras, the time and the pose of a frame."""
    return not any(_invalid_header(frame, requirements))


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
        causes = {
            "timestamp_s": _time_unit_cause(frame.timestamp_s),
            "global_T_ego": _position_unit_cause(frame.global_T_ego),
        }
        remedies = {"timestamp_s": CORRECT_TIME, "global_T_ego": CORRECT_POSE, "cameras": CORRECT_CAMERA_COUNT}
        yield finding_from_error(subject, error, causes.get(subject, ""), remedies.get(subject, ""))


def _time_unit_cause(timestamp_s: float) -> str:
    """A sentence with the unit in which a number is a Unix time between 1973 and 2286; empty without such a unit."""
    for unit, per_second in UNITS_PER_SECOND.items():
        if 1e8 <= timestamp_s / per_second < 1e10:
            return f"The time is in {unit}."
    return ""


def _position_unit_cause(global_T_ego: NDArray[np.float64]) -> str:
    """A sentence about positions that are too large; empty for others. Projected coordinates are below 1e7 m."""
    largest = np.abs(global_T_ego[:3, 3]).max()
    return "Likely cause: the positions are in millimetres instead of metres." if 1e9 < largest <= 1e10 else ""


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


def _interval_finding(steps: list[MotionStep], requirements: RigRequirements, first_time_s: float) -> Finding | None:
    """A finding if the median time between frames is implausible."""
    elapsed_s = float(np.median([step.elapsed_s for step in steps]))
    largest_s = requirements.largest_time_delta_s
    if elapsed_s <= 0 or SHORTEST_STEP_S <= elapsed_s <= largest_s:
        return None
    cause = _interval_cause(steps, elapsed_s, first_time_s)
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


def _interval_cause(steps: list[MotionStep], elapsed_s: float, first_time_s: float) -> str:
    """The likely cause of a too short or too long time between frames."""
    if elapsed_s < SHORTEST_STEP_S:
        return "Likely cause: the times are in a larger unit than seconds."
    units = [unit for unit, factor in UNITS_PER_SECOND.items() if 0.01 <= elapsed_s / factor <= LONGEST_STEP_S / 5]
    is_unix = UNIX_TIMES_S[0] <= first_time_s < UNIX_TIMES_S[1]
    if units and elapsed_s > (LONGEST_UNIX_STEP_S if is_unix else LONGEST_STEP_S):
        return f"Likely cause: the times are in {units[0]}."
    return (
        "Likely cause: the rig takes few frames, or many frames are missing. "
        "The pipeline resets its history at such gaps."
    )


def _speed_finding(steps: list[MotionStep], requirements: RigRequirements) -> Finding | None:
    """A finding if steps are faster than a vehicle. It is BROKEN if they are the majority."""
    fast = [step for step in steps if step.speed_m_s > requirements.largest_speed_m_s]
    if not fast:
        return None
    first, is_usual = fast[0], len(fast) > len(steps) / 2
    if not is_usual:
        cause = "Likely cause: a scene cut, or a jump of the position. The pipeline resets its history there."
    else:
        cause = speed_cause(fast)
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


def _unit_finding(steps: list[MotionStep]) -> Finding | None:
    """A finding if all steps are tiny but lead in one direction, as with positions in a unit larger than a metre."""
    if len(steps) < LEAST_TINY_STEPS:
        return None
    path_m = sum(float(np.hypot(*(step.after[:2, 3] - step.before[:2, 3]))) for step in steps)
    net_m = float(np.hypot(*(steps[-1].after[:2, 3] - steps[0].before[:2, 3])))
    unit = large_unit(steps)
    if unit is None or net_m < LEAST_STRAIGHTNESS * path_m or path_m > LEAST_STEP_M:
        return None
    return Finding(
        "ego pose",
        Verdict.SUSPECT,
        "positions in metres",
        f"{len(steps)} steps of {path_m / len(steps):.2g} m in one direction",
        f"Likely cause: the positions are in {unit}.",
        CORRECT_POSE,
        steps[0].end,
        len(steps),
    )


def _turn_finding(steps: list[MotionStep], requirements: RigRequirements) -> Finding | None:
    """A finding if steps turn faster than a vehicle. It is BROKEN if they are the majority."""
    turning = [step for step in steps if step.turn_rad_s > requirements.largest_turn_rad_s]
    if not turning:
        return None
    first, is_usual = turning[0], len(turning) > len(steps) / 2
    cause = "Likely cause: a scene cut, or a jump of the heading. The pipeline resets its history there."
    if is_usual:
        cause = f"{turn_cause(steps)} The pipeline resets its history at each such turn."
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
    """A finding if the vehicle does not move along its heading."""
    moving = _moving_steps(steps, requirements)
    if sum(step.distance_m for step in moving) < LEAST_DISTANCE_M:
        return None
    slip_deg = median_slip_deg(moving)
    if slip_deg <= LARGEST_SLIP_DEG:
        return None
    return Finding(
        "direction of motion",
        Verdict.BROKEN if slip_deg > IMPOSSIBLE_SLIP_DEG and len(moving) >= LEAST_STEPS else Verdict.SUSPECT,
        f"motion along the ego x axis, within {LARGEST_SLIP_DEG:g} degrees",
        f"a median angle of {slip_deg:.0f} degrees to it",
        slip_cause(moving),
        CORRECT_POSE,
        moving[0].end,
        len(moving),
    )


def _moving_steps(steps: list[MotionStep], requirements: RigRequirements) -> list[MotionStep]:
    """The steps with a reliable direction.

    Steps with an excessive speed or turn rate are left out. They have other findings, and their direction is arbitrary.
    """
    return [
        step
        for step in steps
        if step.distance_m >= LEAST_STEP_M
        and step.speed_m_s <= requirements.largest_speed_m_s
        and step.turn_rad_s <= requirements.largest_turn_rad_s
    ]


def motion_not_judged(steps: list[MotionStep], requirements: RigRequirements) -> list[NotJudged]:
    """What could not be judged about the poses."""
    if not steps:
        return [NotJudged(NO_STEPS, "no two frames of the same scene")]
    distance_m = sum(step.distance_m for step in _moving_steps(steps, requirements))
    if distance_m >= LEAST_DISTANCE_M:
        return []
    reason = f"too short a drive: {distance_m:.1f} m in steps of at least {LEAST_STEP_M:g} m"
    return [NotJudged(SHORT_DRIVE, reason)]
