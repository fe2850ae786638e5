"""Centres of ground-truth boxes: on the road, in range, and at rest in the global frame while the vehicle moves."""

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Frame
from ..runtime.geometry import inverse, transform
from .findings import Finding, NotJudged, Verdict
from .labelled_frame import LabelledFrame, ranges_m

Array = NDArray[np.float64]
Points = Callable[[Array, Frame], Array]  # from the given centres (D, 3) and their frame to centres in the ego frame

LARGEST_RANGE_M = 150.0
LARGEST_HEIGHT_M, LARGEST_SLOPE = 0.7, 0.05  # of the bottom of a box above the road, and more per metre of range
LEAST_SHARE, LEAST_GAIN = 0.6, 0.3  # of the boxes that are on the road and in range
NEAR_M = 30.0  # farther boxes may be on a slope
LEAST_BOXES = 5
LEAST_OFFSET_M = 0.5  # of the bottoms of near boxes from the road; the ego origin may be as high as the axles
LARGEST_BOTTOM_M = 0.35  # of the centres themselves, if they are those of the bottoms
LEAST_SPREAD_M = 0.3  # of the heights: with less, a wrong origin and bottom centres look alike
SHORTEST_STEP_M, LONGEST_STEP_M = 1.5, 15.0  # between two frames with boxes
LONGEST_STEP_S = 2.0
SAME_PLACE_M = 0.7
LEAST_AT_REST = 6  # boxes that can be compared

CORRECT_CENTRES = (
    "Give center_m in the ego frame (x forward, y left, z up, origin on the road), as the centre of the box."
)
GLOBAL = "Likely cause: the centres are in the global frame instead of the ego frame."
BOTTOM = "Likely cause: the centres are those of the bottoms of the boxes."


def _permuted(order: Sequence[int], signs: Sequence[int]) -> Points:
    return lambda points, frame: points[:, list(order)] * signs


def _from_camera(points: Array, frame: Frame) -> Array:
    """From the camera that looks most straight ahead."""
    if not frame.cameras:
        return points
    camera = max(frame.cameras.values(), key=lambda each: each.camera_T_ego[2, 0])
    return transform(inverse(camera.camera_T_ego), points)


MISTAKES: dict[str, Sequence[Points]] = {  # by cause: from the given centres to those in the ego frame
    GLOBAL: [lambda points, frame: transform(inverse(frame.global_T_ego), points)],
    "Likely cause: the centres are in camera axes (x right, y down, z forward) instead of the ego frame.": [
        _from_camera,
        lambda points, frame: points[:, [2, 0, 1]] * (1, -1, -1),
    ],
    "Likely cause: the axes of the centres are x right, y forward, as of a lidar, instead of x forward, y left.": [
        _permuted((1, 0, 2), (1, -1, 1))
    ],
    "Likely cause: the axes of the centres are x left, y backward instead of x forward, y left.": [
        _permuted((1, 0, 2), (-1, 1, 1))
    ],
    "Likely cause: the x axis of the centres points backward.": [_permuted((0, 1, 2), (-1, -1, 1))],
}


def centre_findings(frames: Sequence[LabelledFrame], poses_are_right: bool = True) -> Iterator[Finding]:
    """Yield at most one finding about the centres of all boxes.

    poses_are_right: whether the boxes of different frames may be compared by means of the ego poses.
    """
    frames = [frame for frame in frames if len(frame.boxes)]
    if sum(len(frame.boxes) for frame in frames) < LEAST_BOXES:
        return
    placed = {cause: max(_share_placed(frames, each) for each in variants) for cause, variants in MISTAKES.items()}
    given = _share_placed(frames, _as_given)
    best = max(placed, key=lambda cause: placed[cause])
    if given < LEAST_SHARE and placed[best] > max(LEAST_SHARE, given + LEAST_GAIN):
        yield _finding(f"{given:.0%} of the boxes on the road and within {LARGEST_RANGE_M:g} m", best, frames)
        return
    at_rest = {cause: max(_share_at_rest(frames, each)[0] for each in variants) for cause, variants in MISTAKES.items()}
    share, num_compared = _share_at_rest(frames, _as_given)
    best = max(at_rest, key=lambda cause: at_rest[cause])
    if poses_are_right and num_compared >= LEAST_AT_REST and at_rest[best] > max(LEAST_SHARE, share + LEAST_GAIN):
        got = f"{share:.0%} of {num_compared} boxes where they were before, according to the ego poses and velocities"
        yield _finding(got, best, frames)
        return
    yield from _height_findings(frames)


def centres_not_judged(frames: Sequence[LabelledFrame]) -> list[NotJudged]:
    """What could not be judged about the centres."""
    num_compared = _share_at_rest(frames, _as_given)[1]
    if num_compared >= LEAST_AT_REST:
        return []
    reason = f"only {num_compared} boxes could be compared between frames while the vehicle moves"
    return [NotJudged("frame of reference of the boxes", reason)]


def _height_findings(frames: Sequence[LabelledFrame]) -> Iterator[Finding]:
    """Yield a finding if the bottoms of the near boxes are not on the road."""
    boxes = np.concatenate([frame.boxes[ranges_m(frame.boxes) < NEAR_M] for frame in frames])
    if len(boxes) < LEAST_BOXES:
        return
    bottom_m = float(np.median(boxes[:, 2] - boxes[:, 5] / 2))
    centre_m = float(np.median(boxes[:, 2]))
    if abs(bottom_m) < LEAST_OFFSET_M:
        return
    got = f"bottoms of near boxes {abs(bottom_m):.1f} m {'above' if bottom_m > 0 else 'below'} the road"
    if abs(centre_m) < LARGEST_BOTTOM_M and abs(centre_m) < abs(bottom_m) / 2 and not _height_counts(boxes):
        yield _finding(got, BOTTOM, frames)
        return
    place = "above" if bottom_m < 0 else "below"
    cause = f"Likely cause: the origin of the boxes is {abs(bottom_m):.1f} m {place} the road, for example at a sensor."
    yield _finding(got, cause, frames)


def _height_counts(boxes: Array) -> bool:
    """Whether higher boxes have higher centres, as centres have and bottoms have not; False if it is unknown."""
    heights = boxes[:, 5]
    if np.std(heights) < LEAST_SPREAD_M:
        return False
    slope = float(np.polyfit(heights, boxes[:, 2], 1)[0])
    return slope > 0.3


def _finding(got: str, cause: str, frames: Sequence[LabelledFrame]) -> Finding:
    return Finding(
        "centres",
        Verdict.SUSPECT,
        "boxes on the road, at the same place in the global frame while they do not move",
        got,
        cause,
        CORRECT_CENTRES,
        frames[0].index,
        len(frames),
    )


def _as_given(points: Array, frame: Frame) -> Array:
    return points


def _share_placed(frames: Sequence[LabelledFrame], to_ego: Points) -> float:
    """The share of the boxes that are in range and on the road."""
    placed = []
    for frame in frames:
        centres = to_ego(frame.boxes[:, :3], frame.frame)
        range_m = np.hypot(centres[:, 0], centres[:, 1])
        # Bottom centres count as well, because they are judged later.
        heights = np.minimum(np.abs(centres[:, 2] - frame.boxes[:, 5] / 2), np.abs(centres[:, 2]))
        placed.append((range_m < LARGEST_RANGE_M) & (heights < LARGEST_HEIGHT_M + LARGEST_SLOPE * range_m))
    return float(np.mean(np.concatenate(placed)))


def _share_at_rest(frames: Sequence[LabelledFrame], to_ego: Points) -> tuple[float, int]:
    """The share of the boxes that are where they were in the frame before, moved by their velocity, and their number.

    The velocities may be in the ego frame even if the centres are not, so both are tried.
    """
    found, num_compared = np.zeros(2, np.int64), 0
    for before, after in pairwise(frames):
        if not _can_be_compared(before, after):
            continue
        elapsed_s = after.frame.timestamp_s - before.frame.timestamp_s
        end = transform(after.frame.global_T_ego, to_ego(after.boxes[:, :3], after.frame))[:, :2]
        is_same_class = np.array([[one == other for other in after.classes] for one in before.classes])
        for variant, start in enumerate(_moved(before, to_ego, elapsed_s)):
            distances = np.linalg.norm(start[:, None] - end, axis=-1) + np.where(is_same_class, 0.0, np.inf)
            found[variant] += int((distances.min(axis=1) < SAME_PLACE_M).sum())
        num_compared += len(before.boxes)
    return float(found.max() / num_compared) if num_compared else 0.0, num_compared


def _can_be_compared(before: LabelledFrame, after: LabelledFrame) -> bool:
    step = after.frame.global_T_ego[:3, 3] - before.frame.global_T_ego[:3, 3]
    elapsed_s = after.frame.timestamp_s - before.frame.timestamp_s
    return (
        before.frame.scene == after.frame.scene
        and 0 < elapsed_s <= LONGEST_STEP_S
        and SHORTEST_STEP_M <= float(np.linalg.norm(step)) <= LONGEST_STEP_M
        and len(before.boxes) > 0
        and len(after.boxes) > 0
    )


def _moved(labelled: LabelledFrame, to_ego: Points, elapsed_s: float) -> tuple[Array, Array]:
    """The places (D, 2) [m] in the global frame after some time. Unknown velocities count as 0.

    The velocities are in the frame of the centres for the first result, and in the ego frame for the second.
    """
    centres, boxes = labelled.boxes[:, :3], labelled.boxes
    motion = np.nan_to_num(np.column_stack([boxes[:, 7:9], np.zeros(len(boxes))])) * elapsed_s
    pose, frame = labelled.frame.global_T_ego, labelled.frame
    together, apart = to_ego(centres + motion, frame), to_ego(centres, frame) + motion
    return transform(pose, together)[:, :2], transform(pose, apart)[:, :2]
