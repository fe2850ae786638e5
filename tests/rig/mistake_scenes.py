"""Scene folders of several rigs, without a mistake. Mistakes are made in copies of their scene.json."""

import json
import os
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from duospacenet.data.scene_writer import write_scene
from duospacenet.runtime.frame import Camera
from duospacenet.runtime.geometry import CAMERA_R_BODY, inverse, rigid_transform, rotation_z
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.synthetic.renderer import Renderer
from examples.nuscenes_scene import write_scene_folder

Record = dict[str, Any]


class Mount(NamedTuple):
    """A camera of a rig: position [m] and azimuth [deg] in the ego frame, and horizontal field of view [deg]."""

    position_m: tuple[float, float, float]
    azimuth_deg: float
    view_deg: float


# Six cameras without directions in their names, the ego origin below the rear axle.
NUMBERED = {
    "CAMERA_01": Mount((2.4, 0.0, 1.5), 0, 48),
    "CAMERA_05": Mount((2.2, 0.45, 1.5), 58, 84),
    "CAMERA_06": Mount((2.2, -0.45, 1.5), -59, 85),
    "CAMERA_07": Mount((0.9, 0.5, 1.52), 121, 84),
    "CAMERA_08": Mount((0.9, -0.5, 1.52), -120, 84),
    "CAMERA_09": Mount((0.2, 0.0, 1.55), 180, 85),
}
# Five cameras with wide lenses.
FIVE = {
    "front": Mount((1.9, 0.0, 1.35), 0, 100),
    "left_front": Mount((1.2, 0.8, 1.1), 70, 100),
    "right_front": Mount((1.2, -0.8, 1.1), -70, 100),
    "left_rear": Mount((0.2, 0.8, 1.2), 140, 100),
    "right_rear": Mount((0.2, -0.8, 1.2), -140, 100),
}
# Seven cameras of a truck, one with a narrow lens.
SEVEN = {
    "cam_front": Mount((3.4, 0.0, 2.3), 0, 90),
    "cam_front_tele": Mount((3.4, 0.2, 2.4), 0, 32),
    "cam_front_left": Mount((3.2, 1.0, 2.2), 60, 80),
    "cam_front_right": Mount((3.2, -1.0, 2.2), -60, 80),
    "cam_rear_left": Mount((1.0, 1.2, 2.4), 120, 80),
    "cam_rear_right": Mount((1.0, -1.2, 2.4), -120, 80),
    "cam_rear": Mount((-1.5, 0.0, 2.4), 180, 90),
}
RIGS = {"nuscenes": None, "numbered": NUMBERED, "five": FIVE, "seven": SEVEN}
UTM_M = (431_278.4, 5_412_911.7, 118.0)  # added to all positions of the other rigs


def write_base(folder: Path, rig: str, seed: int, num_frames: int = 5) -> Path:
    """Write the scene folder of a rig, a drive of a seed. The rig "real" has no seeds."""
    if rig == "real":
        return write_real_base(folder)
    drive = SyntheticDrive(seed, num_frames)
    mounts = RIGS[rig]
    if mounts is not None:
        drive.cameras = build_cameras(mounts, seed)
        drive._renderer = Renderer(seed, drive.cameras)
    write_scene(folder, drive)
    if mounts is not None:
        record = json.loads((folder / "scene.json").read_text())
        for frame in record["frames"]:
            pose = np.array(frame["global_T_ego"])
            pose[:3, 3] += UTM_M
            frame["global_T_ego"] = pose.tolist()
        (folder / "scene.json").write_text(json.dumps(record))
    return folder


def write_real_base(folder: Path) -> Path:
    """Write the real nuScenes frames beside this checkout as a scene folder, with copies of their images."""
    write_scene_folder(folder)
    record = json.loads((folder / "scene.json").read_text())
    for index, frame in enumerate(record["frames"]):
        for name, camera in frame["cameras"].items():
            copy = Path("images") / name / f"{index}.jpg"
            (folder / copy).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(folder / camera["image"], folder / copy)
            camera["image"] = copy.as_posix()
    (folder / "scene.json").write_text(json.dumps(record))
    return folder


def build_cameras(mounts: dict[str, Mount], seed: int, size: tuple[int, int] = (400, 250)) -> dict[str, Camera]:
    """The cameras of a rig, each with deviations of up to a degree and 3 cm."""
    rng = np.random.default_rng([seed, 77])
    cameras = {}
    for name, mount in mounts.items():
        focal = size[0] / 2 / np.tan(np.radians(mount.view_deg) / 2) * rng.uniform(0.99, 1.01)
        intrinsics = np.array([[focal, 0, size[0] * rng.uniform(0.48, 0.52)], [0, focal, size[1] / 2], [0, 0, 1]])
        yaw = np.radians(mount.azimuth_deg + rng.uniform(-1, 1))
        rotation = rotation_z(yaw) @ CAMERA_R_BODY.T
        position = mount.position_m + rng.uniform(-0.03, 0.03, 3)
        cameras[name] = Camera(intrinsics, inverse(rigid_transform(rotation, position)), *size)
    return cameras


def copy_with_mistake(base: Path, folder: Path, record: Record) -> Path:
    """Write a scene.json beside hard links to the images of a scene folder."""
    for path in base.rglob("*.*"):
        if path.name != "scene.json":
            target = folder / path.relative_to(base)
            target.parent.mkdir(parents=True, exist_ok=True)
            os.link(path, target)
    (folder / "scene.json").write_text(json.dumps(record))
    return folder
