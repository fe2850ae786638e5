"""Writes `examples/scene_folder`, a small scene folder in which every documented field occurs.

    python -m examples.example_scene_folder out/scene_folder

Two scenes with two frames each, at 2 Hz, with six cameras of 160×90 pixels. The frames come from a synthetic nuScenes
root, so that the values are consistent: cameras have their own time stamps, so their poses relative to the ego frame
of the frame change from frame to frame. Use it to see what a converter for your own recordings has to write.

- The scene's `cameras` hold what all frames share. Each frame overrides `camera_T_ego`.
- In the last frame, CAM_BACK has an image of half the size, with its own size and intrinsics, as a PNG file. All other
  images are JPEG files.
- In the second frame, CAM_BACK_LEFT is lost, and CAM_BACK_RIGHT is not listed, which means the same.
- The boxes have names of another data set, which `class_mapping` maps.
- The first frame has a mask of 50×50 cells. The boxes of the third frame are unknown.
"""

import argparse
import json
import os
import re
import tempfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from duospacenet.data.mask_grid import MaskGrid
from duospacenet.data.nuscenes.cache_folder import CACHE_VARIABLE
from duospacenet.data.nuscenes.nuscenes_source import NuscenesSource
from duospacenet.runtime.frame import Camera, Frame, GroundTruth
from duospacenet.synthetic.nuscenes_root.root_writer import write_nuscenes_root

SEED = 12
IMAGE_SIZE = (160, 90)
MASK_CELLS = (50, 50)
JPEG_QUALITY = 60
BOX_RANGE_M = 30.0  # farther boxes are left out, so that the file is short
LOST = {1: ("CAM_BACK_LEFT", "CAM_BACK_RIGHT")}  # by frame: the image of the first is null, the second is not listed
HALF_SIZE = (3, "CAM_BACK")
NAMES = {"vehicle.car": "Car", "human.pedestrian.adult": "Person", "movable_object.trafficcone": "Cone"}
CLASS_MAPPING = {"Car": "car", "Person": "pedestrian", "Cone": None}  # boxes named Cone are left out


def main() -> None:
    parser = argparse.ArgumentParser(description="Write the example of a scene folder.")
    parser.add_argument("out", type=Path, help="new folder")
    write_example(parser.parse_args().out)


def write_example(out: Path) -> None:
    """Write the example to the new folder `out`."""
    out.mkdir(parents=True)
    frames = read_frames()
    records = [frame_record(out, index, frame) for index, frame in enumerate(frames)]
    scene = {
        "schema_version": 1,
        "scene": frames[0].scene,
        "cameras": {name: calibration_record(camera) for name, camera in frames[0].cameras.items()},
        "class_mapping": CLASS_MAPPING,
        "frames": records,
    }
    (out / "scene.json").write_text(to_json(scene))


def read_frames() -> list[Frame]:
    """The frames of a synthetic nuScenes root, which exists only during this call."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "root"
        write_nuscenes_root(root, num_scenes=2, num_frames=2, seed=SEED, image_size=IMAGE_SIZE)
        cache, os.environ[CACHE_VARIABLE] = os.environ.get(CACHE_VARIABLE), folder
        try:
            return list(NuscenesSource(str(root), grid=MaskGrid(MASK_CELLS)))
        finally:
            del os.environ[CACHE_VARIABLE]
            if cache is not None:
                os.environ[CACHE_VARIABLE] = cache


def frame_record(out: Path, index: int, frame: Frame) -> dict[str, Any]:
    """The record of a frame. Writes its images and its mask."""
    record: dict[str, Any] = {
        "timestamp_s": frame.timestamp_s,
        "token": f"{index:04d}",
        "scene": frame.scene,
        "global_T_ego": rounded(frame.global_T_ego),
        "cameras": camera_records(out, index, frame),
    }
    truth = frame.ground_truth
    assert truth is not None
    record["boxes"] = None if index == 2 else box_records(truth)
    if index == 0:
        path = f"maps/drivable_area_{index:04d}.png"
        write_image(out / path, truth.maps["drivable_area"].astype(np.uint8) * 255)
        record["maps"] = {"drivable_area": path}
    return record


def camera_records(out: Path, index: int, frame: Frame) -> dict[str, Any]:
    """The cameras of a frame: paths of the images, and the calibration that differs from the scene's."""
    null, missing = LOST.get(index, ("", ""))
    records: dict[str, Any] = {}
    for name, camera in frame.cameras.items():
        if name == missing:
            continue
        pose = {"camera_T_ego": rounded(camera.camera_T_ego)}
        if name == null:
            records[name] = {"image": None, **pose}
        elif (index, name) == HALF_SIZE:
            records[name] = half_size_record(out, f"images/{name}_{index:04d}.png", frame.images[name], camera)
        else:
            path = f"images/{name}_{index:04d}.jpg"
            write_image(out / path, frame.images[name])
            records[name] = {"image": path, **pose}
    return records


def half_size_record(out: Path, path: str, image: np.ndarray | None, camera: Camera) -> dict[str, Any]:
    """The record of an image that is scaled to half its size. The intrinsics are scaled by the same factor.

    The convention of pixels makes this exact: the centre of the first pixel is at (0.5, 0.5).
    """
    assert image is not None
    width_px, height_px = camera.width_px // 2, camera.height_px // 2
    scale = np.diag([width_px / camera.width_px, height_px / camera.height_px, 1.0])
    write_image(out / path, cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA))
    smaller = Camera(scale @ camera.intrinsics_px, camera.camera_T_ego, width_px, height_px)
    return {"image": path, **calibration_record(smaller)}


def calibration_record(camera: Camera) -> dict[str, Any]:
    return {
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "intrinsics_px": rounded(camera.intrinsics_px),
        "camera_T_ego": rounded(camera.camera_T_ego),
    }


def box_records(truth: GroundTruth) -> list[dict[str, Any]]:
    """The boxes of a frame within BOX_RANGE_M. An unknown velocity is null, because JSON has no NaN."""
    assert truth.num_points is not None
    assert truth.attributes is not None
    rows = zip(truth.classes, truth.boxes.round(4).tolist(), truth.num_points.tolist(), truth.attributes, strict=True)
    return [
        {
            "class": NAMES.get(name, name),
            "center_m": box[:3],
            "size_wlh_m": box[3:6],
            "yaw_rad": box[6],
            "velocity_m_s": box[7:] if np.isfinite(box[7:]).all() else None,
            "num_points": num_points,
            "attribute": attribute,
        }
        for name, box, num_points, attribute in rows
        if np.hypot(*box[:2]) < BOX_RANGE_M
    ]


def write_image(path: Path, image: np.ndarray | None) -> None:
    assert image is not None
    path.parent.mkdir(parents=True, exist_ok=True)
    options = [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY] if path.suffix == ".jpg" else []
    assert cv2.imwrite(str(path), image, options)


def rounded(matrix: np.ndarray) -> list[list[float]]:
    return (matrix.round(9) + 0.0).tolist()  # + 0.0 turns -0.0 into 0.0


def to_json(scene: dict[str, Any]) -> str:
    """JSON text with each list of numbers, and each matrix, on one line."""
    text = json.dumps(scene, indent=1)
    for numbers in (r"\[[^][{}\"]*\]", r"\[(?:\s*\[[^][{}\"]*\],?)+\s*\]"):
        text = re.sub(numbers, lambda found: " ".join(found[0].split()).replace("[ ", "[").replace(" ]", "]"), text)
    return text + "\n"


if __name__ == "__main__":
    main()
