"""A tiny nuScenes root with hand-written tables. Its numbers are chosen so that results can be worked out by hand.

The ego drives along global y, so its x axis is global y. scene-0103 has three samples, half a second apart, and
scene-0061 has one. The tables are not sorted.
"""

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.helpers.json_edits import deep_copy

Tables = dict[str, list[dict[str, Any]]]

VERSION = "v1.0-mini"
SIZE_PX = (32, 16)  # width and height
TO_LEFT = [2**-0.5, 0, 0, 2**-0.5]  # a yaw of 90 degrees
LOOKING_FORWARD = [0.5, -0.5, 0.5, -0.5]  # from camera axes to ego axes
LOOKING_BACK = [0.5, -0.5, -0.5, 0.5]
INTRINSICS = [[20.0, 0.0, 16.0], [0.0, 20.0, 8.0], [0.0, 0.0, 1.0]]
START_US = 1_500_000_000_000_000
SAMPLES = {"b0": "s103", "b1": "s103", "b2": "s103", "a0": "s61"}
TIMES_US = {"b0": START_US, "b1": START_US + 500_000, "b2": START_US + 1_000_000, "a0": START_US + 9_000_000}
EGO_Y_M = {"b0": 50.0, "b1": 54.0, "b2": 58.0, "a0": 10.0}
CAMERA_DELAY_US = -50_000
CAMERA_DELAY_M = -0.4  # at 8 m/s


def tiny_tables() -> Tables:
    """Return new tables, which a test may change."""
    return deep_copy(_tiny_tables())


def _tiny_tables() -> Tables:
    return {
        "log": [{"token": "log", "logfile": "", "vehicle": "", "date_captured": "", "location": "boston-seaport"}],
        "scene": [
            {"token": "s103", "name": "scene-0103", "log_token": "log", "nbr_samples": 3},
            {"token": "s61", "name": "scene-0061", "log_token": "log", "nbr_samples": 1},
        ],
        "sensor": [
            {"token": "cb", "channel": "CAM_BACK", "modality": "camera"},
            {"token": "cf", "channel": "CAM_FRONT", "modality": "camera"},
            {"token": "lt", "channel": "LIDAR_TOP", "modality": "lidar"},
            {"token": "rf", "channel": "RADAR_FRONT", "modality": "radar"},
        ],
        "calibrated_sensor": [
            _calibration("ccb", "cb", [-0.5, 0, 1.6], LOOKING_BACK, INTRINSICS),
            _calibration("ccf", "cf", [1.5, 0, 1.6], LOOKING_FORWARD, INTRINSICS),
            _calibration("clt", "lt", [1, 0, 1.8], TO_LEFT, []),
            _calibration("crf", "rf", [3, 0, 0.5], [1, 0, 0, 0], []),
        ],
        "sample": [
            {"token": name, "timestamp": TIMES_US[name], "scene_token": SAMPLES[name], "prev": "", "next": ""}
            for name in ("b2", "a0", "b0", "b1")
        ],
        "sample_data": [
            row
            for name in SAMPLES
            for row in (
                _data(name, "RADAR_FRONT", "crf", 10_000),
                _data(name, "LIDAR_TOP", "clt", 0),
                _data(name, "CAM_BACK", "ccb", CAMERA_DELAY_US),
                _data(name, "CAM_FRONT", "ccf", CAMERA_DELAY_US),
                {**_data(name, "CAM_FRONT", "ccf", 100_000), "token": f"{name}-sweep", "is_key_frame": False},
            )
        ],
        "ego_pose": [
            pose
            for name in SAMPLES
            for pose in (
                _pose(f"{name}-LIDAR_TOP", EGO_Y_M[name]),
                _pose(f"{name}-RADAR_FRONT", EGO_Y_M[name]),
                _pose(f"{name}-CAM_BACK", EGO_Y_M[name] + CAMERA_DELAY_M),
                _pose(f"{name}-CAM_FRONT", EGO_Y_M[name] + CAMERA_DELAY_M),
            )
        ],
        "instance": [
            {"token": "bus", "category_token": "c-bus"},
            {"token": "rack", "category_token": "c-rack"},
            {"token": "walker", "category_token": "c-walker"},
        ],
        "category": [
            {"token": "c-rack", "name": "static_object.bicycle_rack", "description": ""},
            {"token": "c-bus", "name": "vehicle.bus.rigid", "description": ""},
            {"token": "c-walker", "name": "human.pedestrian.adult", "description": ""},
        ],
        "attribute": [
            {"token": "t-moving", "name": "vehicle.moving", "description": ""},
            {"token": "t-stopped", "name": "vehicle.stopped", "description": ""},
        ],
        "visibility": [{"token": "4", "level": "v80-100", "description": ""}],
        "sample_annotation": [
            # Drives ahead of the ego at 8 m/s, then at 4 m/s.
            _annotation("bus0", "b0", "bus", [100, 60, 1.5], ["t-moving"], "", "bus1", (7, 2)),
            _annotation("bus2", "b2", "bus", [100, 66, 1.5], ["t-stopped"], "bus1", "", (1, 0)),
            _annotation("bus1", "b1", "bus", [100, 64, 1.5], ["t-moving"], "bus0", "bus2", (0, 3)),
            # Two metres to the left of the ego in the first sample, which is global -x.
            _annotation("rack0", "b0", "rack", [98, 50, 0.5], [], "", "", (0, 0)),
        ],
    }


def write_tables(root: Path, tables: Tables, version: str = VERSION) -> Path:
    """Write the tables of a version; returns the root."""
    folder = root / version
    folder.mkdir(parents=True, exist_ok=True)
    for name, rows in tables.items():
        (folder / f"{name}.json").write_text(json.dumps(rows, indent=0))
    return root


def write_tiny_root(root: Path, tables: Tables | None = None, version: str = VERSION) -> Path:
    """Write tables, and a JPEG file for each camera image of the tiny root; returns the root."""
    write_tables(root, tiny_tables() if tables is None else tables, version)
    for name in SAMPLES:
        for channel, level in (("CAM_FRONT", 200), ("CAM_BACK", 60)):
            path = root / image_name(name, channel)
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), np.full((SIZE_PX[1], SIZE_PX[0], 3), level, np.uint8))
    return root


def image_name(sample: str, channel: str) -> str:
    """The path of an image, relative to the root."""
    return f"samples/{channel}/{sample}.jpg"


def row(tables: Tables, table: str, token: str) -> dict[str, Any]:
    """The row of a table with this token."""
    return next(each for each in tables[table] if each["token"] == token)


def _calibration(token: str, sensor: str, translation: list, rotation: list, intrinsics: list) -> dict[str, Any]:
    fields = {"translation": translation, "rotation": rotation, "camera_intrinsic": intrinsics}
    return {"token": token, "sensor_token": sensor, **fields}


def _data(sample: str, channel: str, calibration: str, delay_us: int) -> dict[str, Any]:
    is_camera = channel.startswith("CAM")
    return {
        "token": f"{sample}-{channel}",
        "sample_token": sample,
        "ego_pose_token": f"{sample}-{channel}",
        "calibrated_sensor_token": calibration,
        "timestamp": TIMES_US[sample] + delay_us,
        "fileformat": "jpg" if is_camera else "pcd",
        "is_key_frame": True,
        "height": SIZE_PX[1] if is_camera else 0,
        "width": SIZE_PX[0] if is_camera else 0,
        "filename": image_name(sample, channel),
        "prev": "",
        "next": "",
    }


def _pose(token: str, y_m: float) -> dict[str, Any]:
    return {"token": token, "timestamp": 0, "rotation": TO_LEFT, "translation": [100, y_m, 0]}


def _annotation(
    token: str,
    sample: str,
    instance: str,
    centre: list,
    attributes: list[str],
    previous: str,
    following: str,
    num_points: tuple[int, int],
) -> dict[str, Any]:
    return {
        "token": token,
        "sample_token": sample,
        "instance_token": instance,
        "visibility_token": "4",
        "attribute_tokens": attributes,
        "translation": centre,
        "size": [2.5, 10, 3],
        "rotation": TO_LEFT,
        "prev": previous,
        "next": following,
        "num_lidar_pts": num_points[0],
        "num_radar_pts": num_points[1],
    }
