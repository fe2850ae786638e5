"""Polygons by the thousand: put into one frame, cut at planes, sorted from far to near."""

from collections.abc import Sequence
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import box_corners
from .shapes import Mesh

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Polygons(NamedTuple):
    """F polygons over V points, of D objects.

    points (V, 3), counts (F,), normals (F, 3), colours (F, 3), solid (F,) as in a mesh, here in one common
    frame; owners (F,): the object's index; part_centres (F, 3): the middle of the part it belongs to;
    sequence (F,): its place in the order in which a part is drawn.
    """

    points: Array
    counts: Counts
    normals: Array
    colours: Array
    solid: Flags
    owners: Counts
    part_centres: Array
    sequence: Counts

    def select(self, keep: Flags) -> "Polygons":
        """Those polygons for which `keep` (F,) holds."""
        rest = (field[keep] for field in self[2:])
        return Polygons(self.points[np.repeat(keep, self.counts)], self.counts[keep], *rest)


def assemble(boxes: Array, meshes: Sequence[Mesh]) -> Polygons:
    """Put meshes into their boxes (D, 9)."""
    num_points = [len(mesh.points) for mesh in meshes]
    num_polygons = [len(mesh.counts) for mesh in meshes]
    owners = np.repeat(np.arange(len(meshes)), num_polygons)
    rotate = np.stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6])], axis=1)
    base = np.column_stack([boxes[:, :2], boxes[:, 2] - boxes[:, 5] / 2])
    points = np.concatenate([mesh.points for mesh in meshes])
    part_centres = np.concatenate([mesh.part_centres[mesh.parts] for mesh in meshes])
    return Polygons(
        points=_turn(points, np.repeat(rotate, num_points, axis=0)) + np.repeat(base, num_points, axis=0),
        counts=np.concatenate([mesh.counts for mesh in meshes]),
        normals=_turn(np.concatenate([mesh.normals for mesh in meshes]), rotate[owners]),
        colours=np.concatenate([mesh.colours for mesh in meshes]),
        solid=np.concatenate([mesh.solid for mesh in meshes]),
        owners=owners,
        part_centres=_turn(part_centres, rotate[owners]) + base[owners],
        sequence=np.arange(len(owners)),
    )


def cut(polygons: Polygons, planes: Array) -> Polygons:
    """Keep what lies inside all `planes` (n, 4), see `clip`; the order of polygons changes."""
    distances = polygons.points @ planes[:, :3].T + planes[:, 3]
    starts = first_points(polygons.counts)
    whole = (np.minimum.reduceat(distances, starts) >= 0).all(axis=1)
    touched = (np.maximum.reduceat(distances, starts) > 0).all(axis=1) & ~whole
    crossing = polygons.select(touched)
    points, counts = crossing.points, crossing.counts
    for plane in planes:
        points, counts = clip(points, counts, plane)
    crossing = crossing._replace(points=points, counts=counts)
    return Polygons(*map(np.concatenate, zip(polygons.select(whole), crossing, strict=True)))


def first_points(counts: Counts) -> Counts:
    """The index of each polygon's first point."""
    return np.cumsum(counts) - counts


def clip(points: Array, counts: Counts, plane: Array) -> tuple[Array, Counts]:
    """Cut polygons at a plane (4,), keeping where `plane[:3] @ point + plane[3] >= 0` (Sutherland, Hodgman 1974).

    A polygon that lies outside is left with a count of 0.
    """
    distance = points @ plane[:3] + plane[3]
    inside = distance >= 0
    if inside.all():
        return points, counts
    following = np.arange(1, len(points) + 1)
    filled = counts > 0
    starts = first_points(counts)[filled]
    following[starts + counts[filled] - 1] = starts
    crosses = inside != inside[following]
    span = np.where(crosses, distance - distance[following], 1.0)
    cut = points + (distance / span)[:, None] * (points[following] - points)
    kept = np.stack([inside, crosses], axis=1)
    owner = np.repeat(np.arange(len(counts)), counts)
    new_counts = np.bincount(owner, weights=kept.sum(axis=1), minlength=len(counts)).astype(np.int64)
    return np.stack([points, cut], axis=1)[kept], new_counts


class Arrangement:
    """How upright boxes (D, 9) that do not meet stand to each other, so that they can be drawn far to near.

    Two such boxes are parted by the line of a side of one of them. The one on the eye's side of that line may
    hide the other, never the reverse.
    """

    def __init__(self, boxes: Array) -> None:
        self._corners = box_corners(boxes)[:, :4, :2]
        self._centres = boxes[:, :2]
        self._yaws = boxes[:, 6]
        self._half = boxes[:, [4, 3]] / 2
        between = boxes[None, :, 6] - boxes[:, None, 6]
        cos, sin = np.abs(np.cos(between)), np.abs(np.sin(between))
        length, width = self._half.T
        reach = np.stack([length * cos + width * sin, length * sin + width * cos], axis=-1)
        offset = self._local(self._centres)
        half = self._half[:, None]
        self._beyond = np.concatenate([offset - reach >= half, offset + reach <= -half], axis=2)

    def far_to_near(self, candidates: Counts, eye: Array) -> Counts:
        """The order in which `candidates` (n,), indices of boxes, are drawn as seen from `eye` (2,)."""
        behind, before = np.nonzero(self._may_hide(candidates, eye).T)
        distances = np.linalg.norm(self._centres[candidates] - eye, axis=1)
        return candidates[_sort_by_constraints(distances, behind.tolist(), before.tolist())]

    def _may_hide(self, candidates: Counts, eye: Array) -> Flags:
        """(n, n): candidate i may hide candidate j."""
        local_eye = self._local(eye[None])[candidates]
        half = self._half[candidates][:, None]
        eye_beyond = np.concatenate([local_eye >= half, local_eye <= -half], axis=2)
        beyond = self._beyond[np.ix_(candidates, candidates)]
        other_may = (beyond & eye_beyond).any(axis=2)
        self_may = (beyond & ~eye_beyond).any(axis=2)
        hides = self_may | other_may.T
        return hides & ~hides.T & _overlap_in_azimuth(self._corners[candidates] - eye)

    def _local(self, points: Array) -> Array:
        """Points (n, 2) relative to each box: (D, n, 2), along it and to its left."""
        offset = points[None] - self._centres[:, None]
        return _turn(offset, np.stack([np.cos(self._yaws), -np.sin(self._yaws)], axis=1)[:, None])


def _sort_by_constraints(distances: Array, behind: list[int], before: list[int]) -> list[int]:
    """Indices, the farthest first, but every behind[k] ahead of its before[k]."""
    followers: list[list[int]] = [[] for _ in distances]
    num_waiting_for = [0] * len(distances)
    for first, second in zip(behind, before, strict=True):
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
    """(n, n): two footprints (n, 4, 2), relative to the eye, have a direction in common."""
    middle = np.arctan2(*corners.mean(axis=1).T[::-1])
    offset = _wrap(np.arctan2(corners[..., 1], corners[..., 0]) - middle[:, None])
    between = _wrap(middle[None, :] - middle[:, None])
    low, high = offset.min(axis=1), offset.max(axis=1)
    return (between + low[None, :] <= high[:, None]) & (between + high[None, :] >= low[:, None])


def _wrap(angles: Array) -> Array:
    return angles - 2 * np.pi * np.rint(angles / (2 * np.pi))


def _turn(vectors: Array, rotate: Array) -> Array:
    """Turn vectors (..., 2 or 3) about z by angles given as (..., 2) cosine and sine."""
    turned = vectors.copy()
    turned[..., 0] = rotate[..., 0] * vectors[..., 0] - rotate[..., 1] * vectors[..., 1]
    turned[..., 1] = rotate[..., 1] * vectors[..., 0] + rotate[..., 0] * vectors[..., 1]
    return turned
