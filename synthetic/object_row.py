"""Rows of objects beside the centre line of a street."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .centre_line import CentreLine, offset_left
from .class_sizes import CLASS_SIZES_M, WIDEST_M, Size
from .mesh import Mesh
from .object_meshes import build_mesh
from .snapshot import Snapshot

Rng = np.random.Generator


class RowObject(NamedTuple):
    """An object of a row.

    name: a class, or "house", "tree" or "lamp".
    along_m: arc length of its centre at the start of the drive. A block generator gives it relative to
        the start of its block.
    across_m: distance of its centre to the left of the row.
    turn_rad: its heading relative to the direction of the row.
    identity: integers that identify the object in all frames; assigned by the world.
    """

    name: str
    along_m: float
    across_m: float
    turn_rad: float
    size_m: Size
    mesh: Mesh
    identity: tuple[int, ...]


GenerateBlock = Callable[[Rng, int], Iterable[RowObject]]  # takes the random stream and the index of a block
IsKept = Callable[[RowObject], bool]  # false for an object that is removed from its block


@dataclass(frozen=True)
class ObjectRow:
    """Objects on a line at a constant distance from a centre line, all moving along it at the same rate.

    across_m: distance of the line to the left of the centre line.
    rate_m_s: change of arc length per second.
    direction: +1 where objects face forward along the centre line, -1 where they face backward.
    block_m: length of a block. Each block has its own random stream.
    generate_block: generates the objects of a block.
    is_kept: decides which of them remain.
    """

    centre_line: CentreLine
    across_m: float
    rate_m_s: float
    direction: int
    block_m: float
    generate_block: GenerateBlock
    is_kept: IsKept


def random_object(name: str, rng: Rng) -> RowObject:
    """An object of a class, up to 10 % smaller or larger than usual, at the origin of its row."""
    size = np.array(CLASS_SIZES_M[name]) * np.clip(rng.normal(1.0, 0.05, 3), 0.9, 1.1)
    size[0] = min(size[0], WIDEST_M)
    size_m = (float(size[0]), float(size[1]), float(size[2]))
    return RowObject(name, 0.0, 0.0, 0.0, size_m, build_mesh(name, size_m, rng), ())


def scenery_object(name: str, size_m: Size, along_m: float, rng: Rng) -> RowObject:
    """A house, tree or lamp of a given size."""
    return RowObject(name, along_m, 0.0, 0.0, size_m, build_mesh(name, size_m, rng), ())


def place_objects(row: ObjectRow, time_s: float, objects: Sequence[RowObject]) -> Snapshot:
    """Objects of a row in the global frame, `time_s` after the start."""
    along = np.array([item.along_m for item in objects]) + row.rate_m_s * time_s
    across = row.across_m + np.array([item.across_m for item in objects])
    boxes = np.zeros((len(objects), 9))
    x, y, heading, curvature = row.centre_line.interpolate(along).T
    boxes[:, :2] = offset_left(x, y, heading, across)
    boxes[:, 3:6] = np.array([item.size_m for item in objects]).reshape(-1, 3)
    boxes[:, 2] = boxes[:, 5] / 2
    # An equal rate of arc length is a higher speed on the outside of a bend.
    speed = row.rate_m_s * (1 - curvature * across)
    boxes[:, 6] = heading + (0.0 if row.direction > 0 else np.pi) + [item.turn_rad for item in objects]
    boxes[:, 7], boxes[:, 8] = speed * np.cos(heading), speed * np.sin(heading)
    return Snapshot(
        boxes,
        tuple(item.name for item in objects),
        tuple(item.mesh for item in objects),
        tuple(item.identity for item in objects),
    )
