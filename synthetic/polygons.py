"""Polygons by the thousand: put into one frame, cut at planes, sorted from far to near."""

from collections.abc import Sequence
from heapq import heapify, heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.geometry import box_corners
from .mesh import Mesh

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Polygons(NamedTuple):
    """F polygons over V points, of D objects, in the order in which a part's polygons are drawn.

    points .. two_sided: as in a mesh, here in one common frame; offsets: (F,) `normals @ point` of their planes;
    owners: (F,) the object's index.
    """

    points: Array
    counts: Counts
    normals: Array
    areas: Array
    colours: Array
    part_centres: Array
    solid: Flags
    two_sided: Flags
    offsets: Array
    owners: Counts

    def select(self, keep: Flags) -> "Polygons":
        """Those polygons for which `keep` (F,) holds."""
        kept = {name: field[keep] for name, field in self._asdict().items() if name != "points"}
        return Polygons(points=self.points[np.repeat(keep, self.counts)], **kept)

    def apparent_areas(self, eye: Array) -> Array:
        """Solid angles (F,) [sr], about, as seen from `eye` (3,); negative where the back is seen."""
        towards = self.normals @ eye - self.offsets
        towards = np.where(self.two_sided, np.abs(towards), towards)
        x, y, z = (self.part_centres - eye).T
        return self.areas * towards / (x * x + y * y + z * z) ** 1.5


class Cut(NamedTuple):
    """Polygons cut at planes: those that lie inside, and what is left of those that cross.

    points (V', 3); starts and counts (F',): each polygon's points; sources (F',): which one it was, in order.
    """

    points: Array
    starts: Counts
    counts: Counts
    sources: Counts


def assemble(boxes: Array, meshes: Sequence[Mesh]) -> Polygons:
    """Put meshes into their boxes (D, 9)."""
    num_points = [len(mesh.points) for mesh in meshes]
    num_polygons = [len(mesh.counts) for mesh in meshes]
    owners = np.repeat(np.arange(len(meshes)), num_polygons)
    rotate = np.stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6])], axis=1)
    base = np.column_stack([boxes[:, :2], boxes[:, 2] - boxes[:, 5] / 2])
    points = np.concatenate([mesh.points for mesh in meshes])
    points = _turn(points, np.repeat(rotate, num_points, axis=0)) + np.repeat(base, num_points, axis=0)
    counts = np.concatenate([mesh.counts for mesh in meshes])
    normals = _turn(np.concatenate([mesh.normals for mesh in meshes]), rotate[owners])
    part_centres = np.concatenate([mesh.part_centres for mesh in meshes])
    return Polygons(
        points=points,
        counts=counts,
        normals=normals,
        areas=np.concatenate([mesh.areas for mesh in meshes]),
        colours=np.concatenate([mesh.colours for mesh in meshes]),
        part_centres=_turn(part_centres, rotate[owners]) + base[owners],
        solid=np.concatenate([mesh.solid for mesh in meshes]),
        two_sided=np.concatenate([mesh.two_sided for mesh in meshes]),
        offsets=np.einsum("fk,fk->f", normals, points[first_points(counts)]),
        owners=owners,
    )


def cut(points: Array, counts: Counts, planes: Array) -> Cut:
    """Keep what of polygons (V, 3), (F,) lies inside all `planes` (n, 4); see `clip`."""
    starts = first_points(counts)
    inside = planes[:, :3] @ points.T + planes[:, 3:] >= 0
    is_whole = np.logical_and.reduceat(np.logical_and.reduce(inside), starts)
    is_crossing = np.logical_and.reduce(np.logical_or.reduceat(inside, starts, axis=1)) & ~is_whole
    pieces, piece_counts = points[np.repeat(is_crossing, counts)], counts[is_crossing]
    for plane in planes:
        pieces, piece_counts = clip(pieces, piece_counts, plane)
    left = piece_counts > 0
    whole, crossing = np.flatnonzero(is_whole), np.flatnonzero(is_crossing)[left]
    sources = np.concatenate([whole, crossing])
    order = np.argsort(sources, kind="stable")
    return Cut(
        np.concatenate([points, pieces]),
        np.concatenate([starts[whole], len(points) + first_points(piece_counts)[left]])[order],
        np.concatenate([counts[whole], piece_counts[left]])[order],
        sources[order],
    )


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
        axes = np.stack([np.cos(self._yaws), np.sin(self._yaws)])
        cos = np.abs(axes.T @ axes)
        sin = np.abs(axes.T @ np.stack([-axes[1], axes[0]]))
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
