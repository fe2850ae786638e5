"""The four real frames that lie beside the repository, as Frames and as a scene folder.

They are nuScenes data (CC BY-NC-SA 4.0), for checking only: they are read where they are and never copied.
The file writes nuScenes' words (`a2b` maps a to b, boxes in LIDAR_TOP axes: x right, y forward); here they
become ours.
"""

import json
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from duospacenet.runtime.frame import Camera, Frame, GroundTruth
from duospacenet.runtime.geometry import inverse, transform

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "nuscenes_scene0103"


def is_here() -> bool:
    """Whether the data lie beside this checkout."""
    return (DATA / "frames.json").is_file()


def load_records() -> list[dict[str, Any]]:
    """The frames as the file has them."""
    return json.loads((DATA / "frames.json").read_text())


def load_frames() -> list[Frame]:
    """The frames with images, calibration at each camera's own time stamp, and truth in the ego frame."""
    return [to_frame(record) for record in load_records()]


def to_frame(record: dict[str, Any]) -> Frame:
    """One record of the file as a Frame."""
    cameras = {name: to_camera(camera, record) for name, camera in record["cams"].items()}
    images = {name: cv2.imread(str(image_path(camera))) for name, camera in record["cams"].items()}
    return Frame(
        images=images,
        cameras=cameras,
        global_T_ego=np.array(record["ego2global"]),
        timestamp_s=record["timestamp_us"] * 1e-6,
        scene=record["scene"],
        token=record["token"],
        ground_truth=to_truth(record),
    )


def image_path(camera: dict[str, Any]) -> Path:
    """Where a camera's JPEG lies."""
    return DATA / camera["file"]


def to_camera(camera: dict[str, Any], record: dict[str, Any]) -> Camera:
    """Calibration over the global frame: the ego moves between the camera's and the frame's time stamp."""
    camera_T_global = inverse(np.array(camera["ego2global"]) @ np.array(camera["cam2ego"]))
    return Camera(
        intrinsics_px=np.array(camera["K"]),
        camera_T_ego=camera_T_global @ np.array(record["ego2global"]),
        width_px=camera["width"],
        height_px=camera["height"],
    )


def to_truth(record: dict[str, Any]) -> GroundTruth:
    """The annotated boxes in the ego frame; an unknown velocity is NaN."""
    annotated = record["gt"]
    ego_T_lidar = np.array(record["lidar2ego"])
    yaw_lidar = np.array(annotated["yaw"])
    heading_lidar = np.stack([np.cos(yaw_lidar), np.sin(yaw_lidar), np.zeros_like(yaw_lidar)], axis=-1)
    heading = heading_lidar @ ego_T_lidar[:3, :3].T
    velocity = np.array(annotated["velocity"], float) @ ego_T_lidar[:3, :3].T
    boxes = np.concatenate(
        [
            transform(ego_T_lidar, np.array(annotated["center"])),
            np.array(annotated["wlh"]),
            np.arctan2(heading[:, 1], heading[:, 0])[:, None],
            velocity[:, :2],
        ],
        axis=1,
    )
    return GroundTruth(boxes=boxes, classes=tuple(annotated["name"]))


def write_scene_folder(directory: Path, frames: Sequence[int] = (0, 1, 2, 3), times: int = 1) -> Path:
    """Write `scene.json` into a folder, for these of the four frames; images stay where they are.

    times: how often they are played, each time as a scene of its own. Returns the folder.
    """
    records = [load_records()[frame] for frame in frames]
    directory.mkdir(parents=True, exist_ok=True)
    scene = {
        "schema_version": 1,
        "scene": records[0]["scene"],
        "frames": [_scene_frame(record, time) for time in range(times) for record in records],
    }
    (directory / "scene.json").write_text(json.dumps(scene, indent=1))
    return directory


def _scene_frame(record: dict[str, Any], time: int) -> dict[str, Any]:
    again = f", time {time + 1}" if time else ""
    return {
        "timestamp_s": record["timestamp_us"] * 1e-6,
        "scene": record["scene"] + again,
        "token": record["token"] + again,
        "global_T_ego": record["ego2global"],
        "cameras": {name: _scene_camera(camera, record) for name, camera in record["cams"].items()},
        "boxes": list(_scene_boxes(to_truth(record))),
    }


def _scene_camera(camera: dict[str, Any], record: dict[str, Any]) -> dict[str, Any]:
    calibration = to_camera(camera, record)
    return {
        "image": str(image_path(camera)),
        "width_px": calibration.width_px,
        "height_px": calibration.height_px,
        "intrinsics_px": calibration.intrinsics_px.tolist(),
        "camera_T_ego": calibration.camera_T_ego.tolist(),
    }


def _scene_boxes(truth: GroundTruth) -> Iterator[dict[str, Any]]:
    for name, box in zip(truth.classes, truth.boxes.tolist(), strict=True):
        yield {
            "class": name,
            "center_m": box[:3],
            "size_wlh_m": box[3:6],
            "yaw_rad": box[6],
            "velocity_m_s": box[7:] if np.isfinite(box[7:]).all() else None,
        }


if __name__ == "__main__":
    write_scene_folder(Path(sys.argv[1]), times=int(sys.argv[2]) if len(sys.argv) > 2 else 1)
