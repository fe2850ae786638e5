"""What can be wrong with the times and poses of a recording: units, order, directions."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError
from ..runtime.frame import Frame
from ..runtime.geometry import inverse, rotation_angle
from ..runtime.validation import check_frame_header
from .findings import Finding, Verdict, merge, refusal
from .requirements import RigRequirements

Array = NDArray[np.float64]

LEAST_MOVED_M = 0.5  # between two frames: shorter ways have no sure direction
LEAST_WAY_M = 5.0  # in all: a parked vehicle's position wanders, or jumps once, whatever its heading is
LARGEST_SLIP_DEG = 20.0  # against the ego's x axis: wheels roll forward; a rear axle slips by a few degrees
IMPOSSIBLE_SLIP_DEG = 45.0
LEAST_STEPS = 3  # that make a slip certain
ALONG_DEG = 10.0  # another reading explains sideways motion if it leaves less than this
SHORTEST_STEP_S = 0.002  # no camera takes 500 frames a second; frames counted in seconds of a faster clock do
FRACTIONS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}

INVERTED = "global_T_ego is inverted: it is ego_T_global."
CORRECT_TIME = "Give timestamp_s in seconds, in the order of the frames."
CORRECT_NUMBER = "Leave cameras out, or export for as many."
GIVE = "Give the frame its cameras, with null for the image of a lost one, or leave it out."
CORRECT_POSE = (
    "Correct global_T_ego: it maps points of the ego frame (x forward, y left, z up) to the global frame, in metres."
)


@dataclass(frozen=True)
class Step:
    """From one frame of a scene, `start`, to the next, `end`.

    distance_m and turn_rad: between the two poses.
    moved: (3,) [m], seen from the ego between the two; read_inversely: the same if the poses were ego_T_global.
    """

    start: int
    end: int
    elapsed_s: float
    distance_m: float
    turn_rad: float
    moved: Array
    read_inversely: Array

    @property
    def speed_m_s(self) -> float:
        return self.distance_m / self.elapsed_s if self.elapsed_s > 0 else np.nan

    @property
    def turn_rad_s(self) -> float:
        return self.turn_rad / self.elapsed_s if self.elapsed_s > 0 else np.nan


def moment_findings(frames: list[Frame], requirements: RigRequirements) -> list[Finding]:
    """What the pipeline refuses before it looks at a camera: how many there are, times and poses."""
    return merge((index, finding) for index, frame in enumerate(frames) for finding in _refused(frame, requirements))


def step_findings(steps: list[Step], requirements: RigRequirements) -> list[Finding]:
    """What is wrong between frames whose times and poses are possible."""
    if not steps:
        return []
    found = (
        _order(steps),
        _interval(steps, requirements),
        _speed(steps, requirements),
        _turn(steps, requirements),
        _slip(steps, requirements),
    )
    return [finding for finding in found if finding is not None]


def steps_of(frames: list[Frame], requirements: RigRequirements) -> list[Step]:
    """The steps within scenes, over frames that the pipeline refuses."""
    possible = [(index, frame) for index, frame in enumerate(frames) if not any(_refused(frame, requirements))]
    return [
        _step(start, end, before, after)
        for (start, before), (end, after) in pairwise(possible)
        if before.scene == after.scene
    ]


def _step(start: int, end: int, before: Frame, after: Frame) -> Step:
    moved, inversely = (
        _moved(first, second)
        for first, second in (
            (before.global_T_ego, after.global_T_ego),
            (inverse(before.global_T_ego), inverse(after.global_T_ego)),
        )
    )
    return Step(
        start=start,
        end=end,
        elapsed_s=float(after.timestamp_s) - float(before.timestamp_s),
        distance_m=float(np.linalg.norm(after.global_T_ego[:3, 3] - before.global_T_ego[:3, 3])),
        turn_rad=rotation_angle(before.global_T_ego[:3, :3].T @ after.global_T_ego[:3, :3]),
        moved=moved,
        read_inversely=inversely,
    )


def _moved(before: Array, after: Array) -> Array:
    """The way (3,) between two poses, in the ego frame: the mean of how both of them see it."""
    way = after[:3, 3] - before[:3, 3]
    return (before[:3, :3].T @ way + after[:3, :3].T @ way) / 2


def _refused(frame: Frame, requirements: RigRequirements) -> Iterator[Finding]:
    if not frame.cameras:
        yield Finding(
            "cameras", Verdict.BROKEN, "at least one", "none", "Neither the frame nor the scene has any.", GIVE
        )
        return
    try:
        check_frame_header(frame, requirements.num_cameras or len(frame.cameras))
    except InputError as error:
        subject = str(error).split(":")[0]
        cause = {"timestamp_s": _unit_cause(frame.timestamp_s)}
        remedy = {"timestamp_s": CORRECT_TIME, "global_T_ego": CORRECT_POSE, "cameras": CORRECT_NUMBER}
        yield refusal(subject, error, cause.get(subject, ""), remedy.get(subject, ""))


def _unit_cause(timestamp_s: float) -> str:
    """The unit in which a Unix time is as late as this."""
    unit = next((unit for unit, fraction in FRACTIONS.items() if 1e8 <= timestamp_s / fraction < 1e10), None)
    return f"It is in {unit}." if unit else ""


def _order(steps: list[Step]) -> Finding | None:
    wrong = [step for step in steps if step.elapsed_s <= 0]
    if not wrong:
        return None
    return Finding(
        "time order",
        Verdict.BROKEN,
        "every frame of a scene later than the one before",
        f"{wrong[0].elapsed_s:.6g} s from frame {wrong[0].start} to frame {wrong[0].end}",
        "Frames are out of order or given twice, or times were rounded to float32.",
        CORRECT_TIME,
        wrong[0].end,
        len(wrong),
    )


def _interval(steps: list[Step], requirements: RigRequirements) -> Finding | None:
    elapsed_s = float(np.median([step.elapsed_s for step in steps]))
    largest_s = requirements.largest_time_delta_s
    if elapsed_s <= 0 or SHORTEST_STEP_S <= elapsed_s <= largest_s:
        return None
    units = [unit for unit, fraction in FRACTIONS.items() if SHORTEST_STEP_S <= elapsed_s / fraction <= largest_s]
    cause = "The network remembers nothing over such gaps: too many frames were left out."
    if elapsed_s < SHORTEST_STEP_S:
        cause = "The times are in a larger unit than seconds."
    if units:
        cause = f"The times are in {units[0]}."
    return Finding(
        "time between frames",
        Verdict.SUSPECT,
        f"{SHORTEST_STEP_S:g} to {largest_s:g} s",
        f"{elapsed_s:.6g} s in the median",
        cause,
        CORRECT_TIME,
        steps[0].end,
        len(steps),
    )


def _speed(steps: list[Step], requirements: RigRequirements) -> Finding | None:
    fast = [step for step in steps if step.speed_m_s > requirements.largest_speed_m_s]
    if not fast:
        return None
    speed = float(np.median([step.speed_m_s for step in fast]))
    is_always = len(fast) > len(steps) / 2
    cause = "The scene is cut there, or the position jumped: the pipeline drops its history."
    if is_always:
        cause = "Positions are not in metres (millimetres, degrees), or times are not in seconds."
        if _median_m([step.read_inversely for step in fast]) < _median_m([step.moved for step in fast]) / 10:
            cause = INVERTED
    return Finding(
        "speed",
        Verdict.BROKEN if is_always else Verdict.SUSPECT,
        f"at most {requirements.largest_speed_m_s:g} m/s",
        f"{speed:.4g} m/s from frame {fast[0].start} to frame {fast[0].end}",
        cause,
        CORRECT_POSE,
        fast[0].end,
        len(fast),
    )


def _turn(steps: list[Step], requirements: RigRequirements) -> Finding | None:
    turning = [step for step in steps if step.turn_rad_s > requirements.largest_turn_rad_s]
    if not turning:
        return None
    first, is_always = turning[0], len(turning) > len(steps) / 2
    cause = "The scene is cut there, or the heading jumped: the pipeline drops its history."
    if is_always:
        cause = "Headings flip, or degrees were taken as radians: the pipeline drops its history at every turn."
    return Finding(
        "turn",
        Verdict.BROKEN if is_always else Verdict.SUSPECT,
        f"at most {np.degrees(requirements.largest_turn_rad_s):g} degrees a second",
        f"{np.degrees(first.turn_rad):.0f} degrees in {first.elapsed_s:.3g} s, from frame {first.start} to {first.end}",
        cause,
        CORRECT_POSE,
        first.end,
        len(turning),
    )


def _slip(steps: list[Step], requirements: RigRequirements) -> Finding | None:
    """Motion that is not along the heading; jumps and flips have findings of their own, and no direction."""
    moving = [
        step
        for step in steps
        if np.hypot(*step.moved[:2]) >= LEAST_MOVED_M
        and step.speed_m_s <= requirements.largest_speed_m_s
        and step.turn_rad_s <= requirements.largest_turn_rad_s
    ]
    if sum(step.distance_m for step in moving) < LEAST_WAY_M:
        return None
    slip_deg = _median_slip_deg([step.moved for step in moving])
    if slip_deg <= LARGEST_SLIP_DEG:
        return None
    causes = []
    if _median_slip_deg([step.read_inversely for step in moving]) < ALONG_DEG:
        causes.append(INVERTED)
    if _median_slip_deg([step.moved[[1, 0, 2]] for step in moving]) < ALONG_DEG:
        causes.append("The ego frame has y ahead, not x, or its heading is counted from another axis.")
    return Finding(
        "direction of motion",
        Verdict.BROKEN if slip_deg > IMPOSSIBLE_SLIP_DEG and len(moving) >= LEAST_STEPS else Verdict.SUSPECT,
        f"along the ego's x axis, within {LARGEST_SLIP_DEG:g} degrees",
        f"{slip_deg:.0f} degrees off it in the median",
        " Or: ".join(causes) or "The heading in the poses is wrong.",
        CORRECT_POSE,
        moving[0].end,
        len(moving),
    )


def _median_m(ways: list[Array]) -> float:
    return float(np.median(np.linalg.norm(ways, axis=-1)))


def _median_slip_deg(ways: list[Array]) -> float:
    """The angle between ways (3,) and the x axis, ahead or back."""
    return float(np.median([np.degrees(np.arctan2(abs(way[1]), abs(way[0]))) for way in ways]))
