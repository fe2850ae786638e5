"""The polygons of many objects in one frame, as arrays."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Polygons(NamedTuple):
    """F polygons with V points in total, of D objects. Within a part of an object, they are in rendering order.

    points ... two_sided: as in `Mesh`, but in one common frame.
    offsets: (F,) `normal @ point` for the points of each polygon, which defines its plane.
    owners: (F,) index of the object that a polygon belongs to.
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
        """The polygons for which `keep` (F,) is true."""
        kept = {name: field[keep] for name, field in self._asdict().items() if name != "points"}
        return Polygons(points=self.points[np.repeat(keep, self.counts)], **kept)

    def apparent_areas(self, eye: Array) -> Array:
        """Approximate solid angles (F,) [sr] seen from `eye` (3,); negative where the back faces the eye."""
        towards = self.normals @ eye - self.offsets
        towards = np.where(self.two_sided, np.abs(towards), towards)
        x, y, z = (self.part_centres - eye).T
        return self.areas * towards / (x * x + y * y + z * z) ** 1.5


def assemble_polygons(boxes: Array, meshes: Sequence[Mesh]) -> Polygons:
    """The polygons of D meshes, each moved into its box; boxes: (D, 9)."""
    num_points = [len(mesh.points) for mesh in meshes]
    num_polygons = [len(mesh.counts) for mesh in meshes]
    owners = np.repeat(np.arange(len(meshes)), num_polygons)
    rotation = np.stack([np.cos(boxes[:, 6]), np.sin(boxes[:, 6])], axis=1)
    base = np.column_stack([boxes[:, :2], boxes[:, 2] - boxes[:, 5] / 2])
    points = np.concatenate([mesh.points for mesh in meshes])
    points = rotate_about_z(points, np.repeat(rotation, num_points, axis=0)) + np.repeat(base, num_points, axis=0)
    counts = np.concatenate([mesh.counts for mesh in meshes])
    normals = rotate_about_z(np.concatenate([mesh.normals for mesh in meshes]), rotation[owners])
    part_centres = np.concatenate([mesh.part_centres for mesh in meshes])
    return Polygons(
        points=points,
        counts=counts,
        normals=normals,
        areas=np.concatenate([mesh.areas for mesh in meshes]),
        colours=np.concatenate([mesh.colours for mesh in meshes]),
        part_centres=rotate_about_z(part_centres, rotation[owners]) + base[owners],
        solid=np.concatenate([mesh.solid for mesh in meshes]),
        two_sided=np.concatenate([mesh.two_sided for mesh in meshes]),
        offsets=np.einsum("fk,fk->f", normals, points[first_points(counts)]),
        owners=owners,
    )


def first_points(counts: Counts) -> Counts:
    """The index (F,) of the first point of each polygon."""
    return np.cumsum(counts) - counts


def rotate_about_z(vectors: Array, rotation: Array) -> Array:
    """Rotate vectors (..., 2 or 3) about z by angles, given as their cosine and sine (..., 2)."""
    rotated = vectors.copy()
    rotated[..., 0] = rotation[..., 0] * vectors[..., 0] - rotation[..., 1] * vectors[..., 1]
    rotated[..., 1] = rotation[..., 1] * vectors[..., 0] + rotation[..., 0] * vectors[..., 1]
    return rotated
