"""An example converter: it writes nuScenes key frames as a scene folder, the input format of docs/scene-folder.md.

    python -m examples.nuscenes_scene OUT [REPEATS] [--data FOLDER]

The data folder holds the camera images and `frames.json`, a list of key frames with these fields:

    scene, token, timestamp_us
    ego2global, lidar2ego   4x4 matrices
    cams                    by camera: file, width, height, K (3x3), and 4x4 matrices cam2ego, ego2global
    gt                      lists with one element per box: name, center, wlh, yaw, velocity, num_lidar_pts,
                            num_radar_pts

nuScenes writes `a2b` for the matrix that maps points of frame a to frame b. This toolkit writes `b_T_a`.

A converter for another rig does the same three steps:

1. Calibration: give `camera_T_ego` for the frame's time stamp. Here each camera has its own time stamp, and the ego
   vehicle moves between the two (`to_camera`).
2. Boxes: give them in the ego frame, x forward and y left. Here they are in the lidar frame, x right and y forward
   (`to_ground_truth`).
3. Images: give their paths. They are not copied; a symbolic link in the scene folder leads to them (`scene_camera`).

The four frames beside this repository are nuScenes data (CC BY-NC-SA 4.0). They are only read, never copied.
"""

import argparse
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from duospacenet.runtime.frame import Camera, Frame, GroundTruth
from duospacenet.runtime.geometry import inverse, transform

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "nuscenes_scene0103"
LINK = "nuscenes"  # in the scene folder: a symbolic link to the data folder, because paths must stay inside the folder


def main() -> None:
    parser = argparse.ArgumentParser(description="Write nuScenes key frames as a scene folder.")
    parser.add_argument("out", type=Path, help="scene folder to write")
    parser.add_argument("repeats", type=int, nargs="?", default=1, help="write the frames this many times (default 1)")
    parser.add_argument(
        "--data", type=Path, default=DATA, help="folder with frames.json and images (default %(default)s)"
    )
    options = parser.parse_args()
    write_scene_folder(options.out, repeats=options.repeats, data=options.data)


def write_scene_folder(out: Path, frames: Sequence[int] | None = None, repeats: int = 1, data: Path = DATA) -> Path:
    """Write `scene.json` to the folder `out`, and return the folder. The images stay in the data folder.

    frames: indices of the key frames to write; all if None.
    repeats: the number of copies of the frames; each copy is a separate scene.
    """
    records = load_records(data)
    selected = records if frames is None else [records[index] for index in frames]
    scene = {
        "schema_version": 1,
        "scene": selected[0]["scene"],
        "frames": [scene_frame(record, repeat) for repeat in range(repeats) for record in selected],
    }
    out.mkdir(parents=True, exist_ok=True)
    (out / LINK).unlink(missing_ok=True)
    (out / LINK).symlink_to(data.resolve())
    (out / "scene.json").write_text(json.dumps(scene, indent=1))
    return out


def load_records(data: Path = DATA) -> list[dict[str, Any]]:
    """The key frames as in frames.json."""
    return json.loads((data / "frames.json").read_text())


def scene_frame(record: dict[str, Any], repeat: int = 0) -> dict[str, Any]:
    """One frame of scene.json. repeat: from 1 on, scene and token get a suffix, because tokens must be unique."""
    suffix = f", repeat {repeat}" if repeat else ""
    return {
        "timestamp_s": record["timestamp_us"] * 1e-6,
        "scene": record["scene"] + suffix,
        "token": record["token"] + suffix,
        "global_T_ego": record["ego2global"],
        "cameras": {name: scene_camera(camera, record) for name, camera in record["cams"].items()},
        "boxes": list(scene_boxes(to_ground_truth(record))),
    }


def scene_camera(camera: dict[str, Any], record: dict[str, Any]) -> dict[str, Any]:
    """One camera of a frame of scene.json. Its image is found through the link `nuscenes` in the scene folder."""
    calibration = to_camera(camera, record)
    return {
        "image": f"{LINK}/{camera['file']}",
        "width_px": calibration.width_px,
        "height_px": calibration.height_px,
        "intrinsics_px": calibration.intrinsics_px.tolist(),
        "camera_T_ego": calibration.camera_T_ego.tolist(),
    }


def scene_boxes(ground_truth: GroundTruth) -> Iterator[dict[str, Any]]:
    """The boxes of a frame of scene.json. An unknown velocity is null, because JSON has no NaN."""
    assert ground_truth.num_points is not None
    rows = zip(ground_truth.classes, ground_truth.boxes.tolist(), ground_truth.num_points.tolist(), strict=True)
    for name, box, num_points in rows:
        yield {
            "class": name,
            "center_m": box[:3],
            "size_wlh_m": box[3:6],
            "yaw_rad": box[6],
            "velocity_m_s": box[7:] if np.isfinite(box[7:]).all() else None,
            "num_points": num_points,
        }


def to_camera(camera: dict[str, Any], record: dict[str, Any]) -> Camera:
    """The calibration of a camera, with extrinsics that include the ego motion up to the camera's own time stamp.

    The path leads from the ego frame at the frame's time stamp to the global frame, and from there through the ego
    frame at the camera's time stamp to the camera.
    """
    global_T_camera = np.array(camera["ego2global"]) @ np.array(camera["cam2ego"])
    return Camera(
        intrinsics_px=np.array(camera["K"]),
        camera_T_ego=inverse(global_T_camera) @ np.array(record["ego2global"]),
        width_px=camera["width"],
        height_px=camera["height"],
    )


def to_ground_truth(record: dict[str, Any]) -> GroundTruth:
    """The annotated boxes in the ego frame. An unknown velocity is NaN."""
    annotations = record["gt"]
    ego_T_lidar = np.array(record["lidar2ego"])
    ego_R_lidar = ego_T_lidar[:3, :3]
    yaw_lidar = np.array(annotations["yaw"])
    heading_lidar = np.stack([np.cos(yaw_lidar), np.sin(yaw_lidar), np.zeros_like(yaw_lidar)], axis=-1)
    heading = heading_lidar @ ego_R_lidar.T
    velocity = np.array(annotations["velocity"], float) @ ego_R_lidar.T
    boxes = np.concatenate(
        [
            transform(ego_T_lidar, np.array(annotations["center"])),
            np.array(annotations["wlh"]),
            np.arctan2(heading[:, 1], heading[:, 0])[:, None],
            velocity[:, :2],
        ],
        axis=1,
    )
    num_points = np.array(annotations["num_lidar_pts"]) + np.array(annotations["num_radar_pts"])
    return GroundTruth(boxes=boxes, classes=tuple(annotations["name"]), num_points=num_points)


def load_frames(data: Path = DATA) -> list[Frame]:
    """The key frames as Frame objects, which can be given to a pipeline without a scene folder."""
    return [to_frame(record, data) for record in load_records(data)]


def to_frame(record: dict[str, Any], data: Path) -> Frame:
    """One key frame as a Frame, with images and ground truth."""
    cameras = record["cams"]
    return Frame(
        images={name: cv2.imread(str(data / camera["file"])) for name, camera in cameras.items()},
        cameras={name: to_camera(camera, record) for name, camera in cameras.items()},
        global_T_ego=np.array(record["ego2global"]),
        timestamp_s=record["timestamp_us"] * 1e-6,
        scene=record["scene"],
        token=record["token"],
        ground_truth=to_ground_truth(record),
    )


def has_data(data: Path = DATA) -> bool:
    """Whether the data folder is there. Tests that need it are skipped otherwise."""
    return (data / "frames.json").is_file()


if __name__ == "__main__":
    main()
