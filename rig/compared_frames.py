"""The choice of frames whose images are compared with each other: a short run in which the vehicle moves."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from ..runtime.frame import Frame
from .motion_steps import distance_between_m

RUN_LENGTH = 5  # frames
STEP_S, STEP_M = 0.5, 1.5  # the next compared frame is that much later or farther
MAX_PAIRS = 30  # of frames with boxes
MAX_STARTS = 50  # runs that are considered
USUAL_STEP_M = (0.5, 8.0)  # a step with images that can be compared


def compared_frames(frames: Sequence[Frame]) -> list[int]:
    """The positions of the run of frames with the most usable steps; the middle one if the vehicle does not move.

    frames: in order, with valid times and poses. A run is within one scene.
    """
    if not frames:
        return []
    starts = sorted(set(np.linspace(0, len(frames) - 1, MAX_STARTS).astype(int).tolist()))
    starts.sort(key=lambda start: abs(start - (len(frames) - RUN_LENGTH) / 2))
    return max((_run_from(frames, start) for start in starts), key=lambda run: _quality(frames, run))


def pairs_of_frames(frames: Sequence[Frame]) -> list[int]:
    """The positions of pairs of frames from all parts of a recording, and of the frames of a short one."""
    starts = np.linspace(0, len(frames) - 1, min(MAX_PAIRS, len(frames))).astype(int).tolist() if frames else []
    return sorted({index for start in starts for index in _run_from(frames, start, 2)})


def _run_from(frames: Sequence[Frame], start: int, length: int = RUN_LENGTH) -> list[int]:
    """A run of frames from `start` on, with a minimal distance in time or space between them."""
    run = [start]
    for index in range(start + 1, len(frames)):
        before, after = frames[run[-1]], frames[index]
        if before.scene != after.scene or len(run) == length:
            break
        elapsed_s = float(after.timestamp_s) - float(before.timestamp_s)
        if elapsed_s >= 0.9 * STEP_S or _distance_m(before, after) >= STEP_M:
            run.append(index)
    return run


def _quality(frames: Sequence[Frame], run: Sequence[int]) -> tuple[int, int]:
    """The number of usable steps, then the number of frames."""
    steps = [_distance_m(frames[one], frames[other]) for one, other in pairwise(run)]
    return sum(USUAL_STEP_M[0] <= step <= USUAL_STEP_M[1] for step in steps), len(run)


def _distance_m(before: Frame, after: Frame) -> float:
    return distance_between_m(before.global_T_ego, after.global_T_ego)
