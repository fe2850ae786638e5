"""All objects of the synthetic world at one time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..runtime.geometry import transform
from .class_sizes import CLASS_SIZES_M
from .mesh import Mesh

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Snapshot:
    """D objects in one coordinate frame.

    boxes: (D, 9) x y z w l h [m], yaw [rad], vx vy [m/s].
    names: the class of each object, or "house", "tree" or "lamp".
    meshes: one per object.
    identities: integers that identify each object, the same at all times.
    """

    boxes: Array
    names: tuple[str, ...]
    meshes: tuple[Mesh, ...]
    identities: tuple[tuple[int, ...], ...]

    def is_labelled(self) -> NDArray[np.bool_]:
        """Whether each object is of one of the ten classes, (D,). Scenery is not."""
        return np.array([name in CLASS_SIZES_M for name in self.names], dtype=bool)

    def within(self, radius_m: float, position_m: Array) -> "Snapshot":
        """The objects with centres nearer than `radius_m` to a position (2,) [m], measured in x and y."""
        near = np.flatnonzero(np.linalg.norm(self.boxes[:, :2] - position_m, axis=1) < radius_m)
        return Snapshot(
            self.boxes[near],
            tuple(self.names[i] for i in near),
            tuple(self.meshes[i] for i in near),
            tuple(self.identities[i] for i in near),
        )

    def to_ego(self, ego_T_global: Array, heading_rad: float) -> "Snapshot":
        """Convert a snapshot from the global frame to the ego frame.

        ego_T_global: (4, 4).
        heading_rad: yaw of the ego in the global frame.

        The yaws of the result are in (-pi, pi].
        """
        boxes = self.boxes.copy()
        boxes[:, :3] = transform(ego_T_global, boxes[:, :3])
        boxes[:, 6] = np.pi - (np.pi - (boxes[:, 6] - heading_rad)) % (2 * np.pi)
        boxes[:, 7:9] = boxes[:, 7:9] @ ego_T_global[:2, :2].T
        return Snapshot(boxes, self.names, self.meshes, self.identities)


def merge_snapshots(snapshots: Sequence[Snapshot]) -> Snapshot:
    """The objects of all snapshots as one. There must be at least one, and all must be in the same coordinate frame."""
    return Snapshot(
        np.concatenate([snapshot.boxes for snapshot in snapshots]),
        sum((snapshot.names for snapshot in snapshots), ()),
        sum((snapshot.meshes for snapshot in snapshots), ()),
        sum((snapshot.identities for snapshot in snapshots), ()),
    )
