"""Headings of ground-truth boxes: their unit, and their agreement with the velocities."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from .findings import Finding, NotJudged, Verdict
from .labelled_frame import LabelledFrame

Array = NDArray[np.float64]

LARGEST_YAW_RAD = 2 * np.pi + 0.01
LEAST_SHARE_BEYOND = 0.3  # of the yaws; fewer may be turns that were counted up
SMALLEST_YAW_RAD = np.radians(np.pi) + 1e-4  # the largest yaw that was converted from degrees to radians twice
VEHICLES = ("car", "truck", "construction_vehicle", "bus", "trailer", "motorcycle", "bicycle")
LEAST_SPEED_M_S = 1.5
LEAST_BOXES = 5
LEAST_BOXES_WITHOUT_SPEED = 20
LARGEST_OFFSET_RAD = np.radians(25.0)
LARGEST_SHARE, LEAST_EXPLAINED_SHARE = 0.5, 0.75  # of the boxes that point along their velocity
LEAST_MEDIAN_RAD, LEAST_RATIO = np.radians(2.0), 4.0  # of small offsets that a mistake explains

DEGREES = "Likely cause: the yaws are in degrees."
TWICE = "Likely cause: the yaws were converted from degrees to radians, but were in radians already."
CORRECT_YAWS = "Give yaw_rad in radians. Yaw 0 points along the ego x axis, and yaw increases to the left."

# Each undoes a mistake: from the yaws (K,) and the heading of the ego vehicle (K,) to the right yaws.
MISTAKES: dict[str, Callable[[Array, Array], Array]] = {
    TWICE: lambda yaw, ego: np.degrees(yaw),
    DEGREES: lambda yaw, ego: np.radians(yaw),
    "Likely cause: yaw 0 points along y instead of x, or along the width.": lambda yaw, ego: yaw + np.pi / 2,
    "Likely cause: yaw 0 points to the right, or along the width.": lambda yaw, ego: yaw - np.pi / 2,
    "Likely cause: the headings point backward.": lambda yaw, ego: yaw + np.pi,
    "Likely cause: yaw increases to the right.": lambda yaw, ego: -yaw,
    "Likely cause: the yaws are those of camera axes, which increase to the right from the x axis.": (
        lambda yaw, ego: -yaw - np.pi / 2
    ),
    "Likely cause: the yaws are relative to the global frame.": lambda yaw, ego: yaw - ego,
}


def heading_findings(frames: Sequence[LabelledFrame]) -> Iterator[Finding]:
    """Yield at most one finding about the headings of all boxes."""
    yaws = np.concatenate([frame.boxes[:, 6] for frame in frames]) if frames else np.zeros(0)
    if len(yaws) and np.mean(np.abs(yaws) > LARGEST_YAW_RAD) > LEAST_SHARE_BEYOND:
        got = f"{np.abs(yaws).max():.4g}, and {np.mean(np.abs(yaws) > LARGEST_YAW_RAD):.0%} of the yaws beyond 2 pi"
        yield _finding("yaws from -pi to pi", got, DEGREES, frames)
        return
    headings, directions, ego = _moving(frames)
    if len(headings) >= LEAST_BOXES:
        yield from _compare_with_velocities(headings, directions, ego, frames)
    elif len(yaws) >= LEAST_BOXES_WITHOUT_SPEED and _are_converted_twice(frames, yaws):
        got = f"yaws from {yaws.min():.3f} to {yaws.max():.3f} for all {len(yaws)} boxes of several classes"
        yield _finding("objects with different headings", got, TWICE, frames)


def headings_not_judged(frames: Sequence[LabelledFrame]) -> list[NotJudged]:
    """What could not be judged about the headings."""
    num_moving = len(_moving(frames)[0])
    if num_moving >= LEAST_BOXES:
        return []
    return [NotJudged("headings of the boxes", f"only {num_moving} vehicles have a known velocity and move")]


def _compare_with_velocities(
    yaws: Array, directions: Array, ego: Array, frames: Sequence[LabelledFrame]
) -> Iterator[Finding]:
    """Yield a finding if most vehicles do not point along their velocities."""
    share = _share_along(yaws, directions)
    offsets = {cause: _median_offset_rad(undo(yaws, ego), directions) for cause, undo in MISTAKES.items()}
    closest = min(offsets, key=lambda each: offsets[each])
    offset_rad = _median_offset_rad(yaws, directions)
    if share >= LARGEST_SHARE and offset_rad > LEAST_MEDIAN_RAD and offsets[closest] < offset_rad / LEAST_RATIO:
        got = (
            f"a median angle of {np.degrees(offset_rad):.0f} degrees between {len(yaws)} vehicles and their velocities"
        )
        yield _finding("vehicles that point along their velocity", got, closest, frames)
    if share >= LARGEST_SHARE:
        return
    shares = {cause: _share_along(undo(yaws, ego), directions) for cause, undo in MISTAKES.items()}
    cause = max(shares, key=lambda each: shares[each])
    if shares[cause] < LEAST_EXPLAINED_SHARE:
        cause = "Likely cause: yaws or velocities are relative to another frame, or in another unit."
    got = f"{share:.0%} of {len(yaws)} moving vehicles that point along their velocity"
    yield _finding("vehicles that point along their velocity", got, cause, frames)


def _finding(expected: str, got: str, cause: str, frames: Sequence[LabelledFrame]) -> Finding:
    return Finding("headings", Verdict.SUSPECT, expected, got, cause, CORRECT_YAWS, frames[0].index, len(frames))


def _moving(frames: Sequence[LabelledFrame]) -> tuple[Array, Array, Array]:
    """The yaws, the directions of the velocities and the headings of the ego vehicle (K,) for all moving vehicles."""
    rows = []
    for frame in frames:
        rotation = frame.frame.global_T_ego[:3, :3]
        ego = np.arctan2(rotation[1, 0], rotation[0, 0])
        for box, name in zip(frame.boxes, frame.classes, strict=True):
            if name in VEHICLES and np.hypot(*box[7:9]) > LEAST_SPEED_M_S:
                rows.append((box[6], np.arctan2(box[8], box[7]), ego))
    yaws, directions, egos = np.array(rows, np.float64).reshape(-1, 3).T
    return yaws, directions, egos


def _median_offset_rad(yaws: Array, directions: Array) -> float:
    """The median angle between headings (K,) and directions (K,)."""
    return float(np.median(np.abs((yaws - directions + np.pi) % (2 * np.pi) - np.pi)))


def _share_along(yaws: Array, directions: Array) -> float:
    """The share of the yaws (K,) that are about equal to the directions."""
    offsets = np.abs((yaws - directions + np.pi) % (2 * np.pi) - np.pi)
    return float(np.mean(offsets < LARGEST_OFFSET_RAD))


def _are_converted_twice(frames: Sequence[LabelledFrame], yaws: Array) -> bool:
    """Whether the yaws are too small for objects of several classes."""
    classes = {name for frame in frames for name in frame.classes if name is not None}
    return len(classes) > 1 and bool(np.abs(yaws).max() < SMALLEST_YAW_RAD) and len(np.unique(yaws)) > LEAST_BOXES
