"""Mistakes in times and ego poses."""

from collections.abc import Callable

import numpy as np

from duospacenet.runtime.geometry import (
    inverse,
    quaternion_from_rotation,
    rigid_transform,
    rotation_from_quaternion,
    rotation_z,
)
from tests.rig.scene_mistake import Array, Injection, Mistake, Record, Rng

INCH_M = 0.0254


def _times(change: Callable[[int, float], float]) -> Injection:
    def inject(record: Record, rng: Rng) -> list[str]:
        for index, frame in enumerate(record["frames"]):
            frame["timestamp_s"] = change(index, frame["timestamp_s"])
        return []

    return inject


def _poses(change: Callable[[int, Array, Array], Array]) -> Injection:
    """change: from the index, the pose and the first pose to the wrong pose."""

    def inject(record: Record, rng: Rng) -> list[str]:
        first = np.array(record["frames"][0]["global_T_ego"], float)
        for index, frame in enumerate(record["frames"]):
            frame["global_T_ego"] = change(index, np.array(frame["global_T_ego"], float), first).tolist()
        return []

    return inject


def _position(factor: float) -> Injection:
    return _poses(lambda index, pose, first: rigid_transform(pose[:3, :3], pose[:3, 3] * factor))


def _latitude(index: int, pose: Array, first: Array) -> Array:
    east, north, up = pose[:3, 3] - first[:3, 3]
    return rigid_transform(pose[:3, :3], [8.4 + east / 73_000, 49.01 + north / 111_320, up])


def _heading(change: Callable[[float], float]) -> Injection:
    return _poses(
        lambda index, pose, first: rigid_transform(
            rotation_z(change(float(np.arctan2(pose[1, 0], pose[0, 0])))), pose[:3, 3]
        )
    )


def _pose_quaternion(order: tuple[int, ...]) -> Injection:
    return _poses(
        lambda index, pose, first: rigid_transform(
            rotation_from_quaternion(quaternion_from_rotation(pose[:3, :3])[list(order)]), pose[:3, 3]
        )
    )


def _north(inject: Injection) -> Injection:
    def turned(record: Record, rng: Rng) -> list[str]:
        _turn_north(record)
        return inject(record, rng)

    return turned


def _turn_north(record: Record) -> None:
    """Turn the global frame so that the drive leads about to the north-east: headings of about 0 hide mistakes."""
    first = np.array(record["frames"][0]["global_T_ego"], float)
    turn = rotation_z(0.9 - np.arctan2(first[1, 0], first[0, 0]))
    for frame in record["frames"]:
        pose = np.array(frame["global_T_ego"], float)
        position = first[:3, 3] + turn @ (pose[:3, 3] - first[:3, 3])
        frame["global_T_ego"] = rigid_transform(turn @ pose[:3, :3], position).tolist()


DRIVE_MISTAKES: dict[str, Mistake] = {
    "times in ms": Mistake(_times(lambda i, t: 500.0 * i), "in milliseconds", "drive"),
    "times in us": Mistake(_times(lambda i, t: 5e5 * i), "in microseconds", "drive"),
    "Unix times in ms": Mistake(_times(lambda i, t: 1000 * t), "in milliseconds", "drive"),
    "Unix times in us": Mistake(_times(lambda i, t: 1e6 * t), "in microseconds", "drive"),
    "times in float32": Mistake(_times(lambda i, t: float(np.float32(t))), "float32", "drive"),
    "slow rig": Mistake(_times(lambda i, t: 1.53e9 + 3 * i), "takes few frames", "drive"),
    "frames in reverse order": Mistake(_times(lambda i, t: 1.53e9 - i / 2), "out of order", "drive"),
    "constant pose": Mistake(_poses(lambda i, pose, first: first), "one pose was given", "drive", True),
    "latitude and longitude": Mistake(_poses(_latitude), "latitude and longitude", "drive", True),
    "positions in km": Mistake(_position(0.001), "in kilometres", "drive", True),
    "positions in mm": Mistake(_position(1000), "in millimetres", "drive"),
    "positions in cm": Mistake(_position(100), "in centimetres", "drive"),
    "positions in inches": Mistake(_position(1 / INCH_M), "in inches", "drive"),
    "poses inverted": Mistake(_north(_poses(lambda i, pose, first: inverse(pose))), "is inverted", "drive"),
    "heading from the y axis": Mistake(_heading(lambda yaw: yaw - np.pi / 2), "y forward instead of x", "drive"),
    "headings in degrees": Mistake(_north(_heading(np.degrees)), "degrees were read as radians", "drive", True),
    "headings read as degrees": Mistake(_north(_heading(np.radians)), "radians were read as degrees", "drive"),
    "headings to the right": Mistake(_north(_heading(lambda yaw: -yaw)), "increase to the right", "drive"),
    "pose quaternion x y z w": Mistake(_north(_pose_quaternion((1, 2, 3, 0))), "wrong order", "drive"),
    "headings reversed": Mistake(_heading(lambda yaw: yaw + np.pi), "headings are reversed", "drive", True),
}
