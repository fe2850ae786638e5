"""Small rigs of known geometry, and ways to damage them, for tests of the rig checks."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from duospacenet.data.images import write_png
from duospacenet.jobs.sources import open_recording
from duospacenet.rig import Examination, RigRequirements, examine
from duospacenet.runtime.bundle.manifest import PerceptionRange
from duospacenet.runtime.bundle.preprocessing_record import Normalisation, Preprocessing
from duospacenet.runtime.frame import Camera

WIDTH_PX, HEIGHT_PX, FOCAL_PX = 160, 80, 80.0  # a horizontal field of view of 90 degrees
AZIMUTHS_DEG = {"FRONT": 0, "LEFT": 90, "BACK": 180, "RIGHT": -90}
COARSE = PerceptionRange(size=(32, 32, 2), lower_m=(-51.2, -51.2, -3.0), upper_m=(51.2, 51.2, 5.0))

Damage = Callable[[dict[str, Any]], None]  # changes the content of scene.json
MatrixChange = Callable[[np.ndarray], np.ndarray]

# Halves an image of 160x80 px and crops its upper half.
UPPER_HALF_CROP = Preprocessing(
    width_px=80,
    height_px=20,
    colour_order="bgr",
    resize_shrinking="area",
    resize_enlarging="linear",
    crop="centre columns, bottom rows",
    normalisation_in_graph=Normalisation(colour_order="rgb", mean=(0, 0, 0), std=(1, 1, 1)),
)


def level_camera(azimuth_deg: float, position_m=(0.0, 0.0, 1.5), **changes: Any) -> Camera:
    """A level camera with a horizontal field of view of 90 degrees. azimuth_deg: positive to the left."""
    cos, sin = np.round([np.cos(np.radians(azimuth_deg)), np.sin(np.radians(azimuth_deg))], 15)
    rotation = np.array([[sin, -cos, 0.0], [0.0, 0.0, -1.0], [cos, sin, 0.0]])  # rows: right, down, forward
    camera_T_ego = np.eye(4)
    camera_T_ego[:3, :3] = rotation
    camera_T_ego[:3, 3] = -rotation @ position_m
    intrinsics_px = np.array([[FOCAL_PX, 0, WIDTH_PX / 2], [0, FOCAL_PX, HEIGHT_PX / 2], [0, 0, 1]])
    fields = {
        "intrinsics_px": intrinsics_px,
        "camera_T_ego": camera_T_ego,
        "width_px": WIDTH_PX,
        "height_px": HEIGHT_PX,
    }
    return Camera(**(fields | changes))


def write_rig(folder: Path, damage: Damage = lambda scene: None) -> Path:
    """Write a scene folder with three frames, 0.5 s and 4 m apart, and one image per frame for each of four cameras.

    damage: changes the content of scene.json before it is written.
    """
    folder.mkdir(parents=True)
    rng = np.random.default_rng(0)
    for name in AZIMUTHS_DEG:
        for index in range(3):
            write_png(folder / image_name(name, index), rng.integers(0, 255, (HEIGHT_PX, WIDTH_PX, 3), np.uint8))
    cameras = {
        name: {
            "width_px": WIDTH_PX,
            "height_px": HEIGHT_PX,
            "intrinsics_px": level_camera(azimuth).intrinsics_px.tolist(),
            "camera_T_ego": level_camera(azimuth, mount_position(azimuth)).camera_T_ego.tolist(),
        }
        for name, azimuth in AZIMUTHS_DEG.items()
    }
    frames = [
        {
            "timestamp_s": 100.0 + index / 2,
            "global_T_ego": [[1, 0, 0, 600 + 4 * index], [0, 1, 0, 1600], [0, 0, 1, 0], [0, 0, 0, 1]],
            "cameras": {name: {"image": image_name(name, index)} for name in AZIMUTHS_DEG},
        }
        for index in range(3)
    ]
    scene = {"schema_version": 1, "scene": "yard", "cameras": cameras, "frames": frames}
    damage(scene)
    (folder / "scene.json").write_text(json.dumps(scene))
    return folder


def image_name(name: str, index: int) -> str:
    """The image file of a camera in a frame: NAME.png in the first frame, then NAME_1.png and so on."""
    return f"{name}_{index}.png" if index else f"{name}.png"


def examine_source(source: str | Path, num_frames: int = 8, **requirements: Any) -> Examination:
    """Examine a source with a coarse grid. requirements: other fields of RigRequirements."""
    fields = {"perception": COARSE} | requirements
    return examine(open_recording(str(source)), RigRequirements(**fields), num_frames)


def pitch(up_deg: float) -> np.ndarray:
    """(4, 4) the rotation of a camera upward: multiply `camera_T_ego` by it from the left."""
    cos, sin = np.cos(np.radians(up_deg)), np.sin(np.radians(up_deg))
    return np.array([[1, 0, 0, 0], [0, cos, sin, 0], [0, -sin, cos, 0], [0, 0, 0, 1]])


def mount_position(azimuth_deg: float) -> tuple[float, float, float]:
    """The position of a camera of the rig: 0.5 m from the point (1, 0), in its viewing direction, 1.5 m high."""
    return 1 + 0.5 * np.cos(np.radians(azimuth_deg)), 0.5 * np.sin(np.radians(azimuth_deg)), 1.5


def change_extrinsics(name: str, change: MatrixChange) -> Damage:
    """Damage that changes the extrinsics of one camera."""
    return _change_matrix(name, "camera_T_ego", change)


def change_intrinsics(name: str, change: MatrixChange) -> Damage:
    """Damage that changes the intrinsics of one camera."""
    return _change_matrix(name, "intrinsics_px", change)


def change_poses(change: MatrixChange) -> Damage:
    """Damage that changes all ego poses."""

    def damage(scene: dict[str, Any]) -> None:
        for frame in scene["frames"]:
            frame["global_T_ego"] = change(np.array(frame["global_T_ego"], dtype=float)).tolist()

    return damage


def change_times(change: Callable[[float], float]) -> Damage:
    """Damage that changes all time stamps."""

    def damage(scene: dict[str, Any]) -> None:
        for frame in scene["frames"]:
            frame["timestamp_s"] = change(frame["timestamp_s"])

    return damage


def _change_matrix(name: str, field: str, change: MatrixChange) -> Damage:
    def damage(scene: dict[str, Any]) -> None:
        camera = scene["cameras"][name]
        camera[field] = np.asarray(change(np.array(camera[field], dtype=float))).tolist()

    return damage
