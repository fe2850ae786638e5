"""The order in which objects are rendered, so that a near one covers a far one."""

from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import NDArray

from ..runtime.geometry import box_corners
from .polygons import Counts, Flags, rotate_about_z

Array = NDArray[np.float64]


class OcclusionOrder:
    """Sorts upright boxes that do not overlap from far to near, for any position of the eye.

    Two such boxes are separated by the line through a side of one of them. The box on the eye's side of that line
    may hide the other one, but not the reverse. Sorting by distance alone fails for long boxes: a pedestrian behind
    a bus may be nearer than the centre of the bus.
    """

    def __init__(self, boxes: Array) -> None:
        """boxes: (D, 9)."""
        self._corners = box_corners(boxes)[:, :4, :2]
        self._centres = boxes[:, :2]
        self._yaws = boxes[:, 6]
        self._half = boxes[:, [4, 3]] / 2
        axes = np.stack([np.cos(self._yaws), np.sin(self._yaws)])
        cos = np.abs(axes.T @ axes)
        sin = np.abs(axes.T @ np.stack([-axes[1], axes[0]]))
        length, width = self._half.T
        reach = np.stack([length * cos + width * sin, length * sin + width * cos], axis=-1)
        offset = self._to_local(self._centres)
        half = self._half[:, None]
        # (D, D, 4): box j is beyond the line of box i's front, left, back or right side.
        self._beyond = np.concatenate([offset - reach >= half, offset + reach <= -half], axis=2)

    def far_to_near(self, candidates: Counts, eye: Array) -> Counts:
        """Sort `candidates` (n,), indices of boxes, from far to near as seen from `eye` (2,)."""
        behind, in_front = np.nonzero(self._may_hide(candidates, eye).T)
        distances = np.linalg.norm(self._centres[candidates] - eye, axis=1)
        return candidates[_sort_by_constraints(distances, behind.tolist(), in_front.tolist())]

    def _may_hide(self, candidates: Counts, eye: Array) -> Flags:
        """Whether candidate i may hide candidate j, (n, n)."""
        local_eye = self._to_local(eye[None])[candidates]
        half = self._half[candidates][:, None]
        eye_beyond = np.concatenate([local_eye >= half, local_eye <= -half], axis=2)
        beyond = self._beyond[np.ix_(candidates, candidates)]
        i_may_hide_j = (beyond & ~eye_beyond).any(axis=2)
        j_may_hide_i = (beyond & eye_beyond).any(axis=2)
        hides = i_may_hide_j | j_may_hide_i.T
        return hides & ~hides.T & _overlap_in_azimuth(self._corners[candidates] - eye)

    def _to_local(self, points: Array) -> Array:
        """Points (n, 2) in the frame of each box, (D, n, 2): along it, and to its left."""
        offset = points[None] - self._centres[:, None]
        return rotate_about_z(offset, np.stack([np.cos(self._yaws), -np.sin(self._yaws)], axis=1)[:, None])


def _sort_by_constraints(distances: Array, behind: list[int], in_front: list[int]) -> list[int]:
    """Sort indices from far to near, so that behind[k] comes earlier than in_front[k] for every k.

    If the constraints form a cycle, the farthest remaining index comes next.
    """
    followers: list[list[int]] = [[] for _ in distances]
    num_waiting_for = [0] * len(distances)
    for first, second in zip(behind, in_front, strict=True):
        followers[first].append(second)
        num_waiting_for[second] += 1
    by_distance = np.argsort(-distances, kind="stable").tolist()
    rank = {index: place for place, index in enumerate(by_distance)}
    ready = [rank[index] for index, number in enumerate(num_waiting_for) if number == 0]
    heapify(ready)
    order: dict[int, None] = {}
    while len(order) < len(distances):
        index = by_distance[heappop(ready)] if ready else next(i for i in by_distance if i not in order)
        order[index] = None
        for follower in followers[index]:
            num_waiting_for[follower] -= 1
            if num_waiting_for[follower] == 0 and follower not in order:
                heappush(ready, rank[follower])
    return list(order)


def _overlap_in_azimuth(corners: Array) -> Flags:
    """Whether two footprints overlap in azimuth, (n, n); corners: (n, 4, 2) relative to the eye."""
    middle = np.arctan2(*corners.mean(axis=1).T[::-1])
    offset = _wrap(np.arctan2(corners[..., 1], corners[..., 0]) - middle[:, None])
    between = _wrap(middle[None, :] - middle[:, None])
    low, high = offset.min(axis=1), offset.max(axis=1)
    return (between + low[None, :] <= high[:, None]) & (between + high[None, :] >= low[:, None])


def _wrap(angles_rad: Array) -> Array:
    """Wrap angles to [-pi, pi]."""
    return angles_rad - 2 * np.pi * np.rint(angles_rad / (2 * np.pi))
