"""Small rigs of known geometry, and ways to break them, for tests of what is found wrong with a rig."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from duospacenet.data.images import write_png
from duospacenet.runtime.bundle.manifest import Preprocessing
from duospacenet.runtime.frame import Camera, Frame

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 160, 80, 80.0  # 90 degrees across
AZIMUTHS_DEG = {"FRONT": 0, "LEFT": 90, "BACK": 180, "RIGHT": -90}

# Halves a picture of 160x80 and cuts off its upper half.
UPPER_HALF_CUT = Preprocessing(
    width_px=80,
    height_px=20,
    colour_order="bgr",
    resize_shrinking="area",
    resize_enlarging="linear",
    crop="centre columns, bottom rows",
    normalisation_in_graph={},
)


def looking(azimuth_deg: float, position_m=(0.0, 0.0, 1.5), **changes: Any) -> Camera:
    """A level camera that sees 90 degrees across and looks to `azimuth_deg`, counted to the left."""
    cos, sin = np.round([np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))], 15)
    rotation = np.array([[sin, -cos, 0.0], [0.0, 0.0, -1.0], [cos, sin, 0.0]])  # rows: right, down, forward
    camera_T_ego = np.eye(4)
    camera_T_ego[:3, :3] = rotation
    camera_T_ego[:3, 3] = -rotation @ position_m
    intrinsics = np.array([[FOCAL_PX, 0, WIDTH_PX / 2], [0, FOCAL_PX, HEIGHT_PX / 2], [0, 0, 1]])
    fields = {"intrinsics_px": intrinsics, "camera_T_ego": camera_T_ego, "width_px": WIDTH_PX, "height_px": HEIGHT_PX}
    return Camera(**(fields | changes))


def frame_without_images(timestamp_s: float = 10.0, pose=None, cameras=None, scene: str = "yard") -> Frame:
    """A frame whose cameras are all lost."""
    cameras = {"FRONT": looking(0)} if cameras is None else cameras
    return Frame(dict.fromkeys(cameras), cameras, np.eye(4) if pose is None else pose, timestamp_s, scene)


def write_rig(folder: Path, damage: Callable[[dict[str, Any]], None] = lambda scene: None) -> Path:
    """A scene folder of four cameras with a picture each and three frames, 0.5 s and 4 m apart; damage: changes it."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for name in AZIMUTHS_DEG:
        write_png(folder / f"{name}.png", rng.integers(0, 255, (HEIGHT_PX, WIDTH_PX, 3), np.uint8))
    cameras = {
        name: {
            "width_px": WIDTH_PX,
            "height_px": HEIGHT_PX,
            "intrinsics_px": looking(azimuth).intrinsics_px.tolist(),
            "camera_T_ego": looking(azimuth, mount(azimuth)).camera_T_ego.tolist(),
        }
        for name, azimuth in AZIMUTHS_DEG.items()
    }
    frames = [
        {
            "timestamp_s": 100.0 + index / 2,
            "global_T_ego": [[1, 0, 0, 600 + 4 * index], [0, 1, 0, 1600], [0, 0, 1, 0], [0, 0, 0, 1]],
            "cameras": {name: {"image": f"{name}.png"} for name in AZIMUTHS_DEG},
        }
        for index in range(3)
    ]
    scene = {"schema_version": 1, "scene": "yard", "cameras": cameras, "frames": frames}
    damage(scene)
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder


def mount(azimuth_deg: float) -> tuple[float, float, float]:
    """Where a camera of the rig is: half a metre from a point one metre ahead of the origin, in its direction."""
    return 1 + 0.5 * np.cos(np.radians(azimuth_deg)), 0.5 * np.sin(np.radians(azimuth_deg)), 1.5


def extrinsics(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict[str, Any]], None]:
    """Damage to a camera's extrinsics in a written rig."""
    return _changed(name, "camera_T_ego", change)


def intrinsics(name: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict[str, Any]], None]:
    """Damage to a camera's intrinsics in a written rig."""
    return _changed(name, "intrinsics_px", change)


def poses(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict[str, Any]], None]:
    """Damage to every ego pose of a written rig."""

    def damage(scene: dict[str, Any]) -> None:
        for frame in scene["frames"]:
            frame["global_T_ego"] = change(np.array(frame["global_T_ego"], dtype=float)).tolist()

    return damage


def times(change: Callable[[float], float]) -> Callable[[dict[str, Any]], None]:
    """Damage to every time stamp of a written rig."""

    def damage(scene: dict[str, Any]) -> None:
        for frame in scene["frames"]:
            frame["timestamp_s"] = change(frame["timestamp_s"])

    return damage


def _changed(name: str, field: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[dict[str, Any]], None]:
    def damage(scene: dict[str, Any]) -> None:
        camera = scene["cameras"][name]
        camera[field] = np.asarray(change(np.array(camera[field], dtype=float))).tolist()

    return damage
