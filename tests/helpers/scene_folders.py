"""A small scene folder with hand-written values, and exact comparison of frames."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from duospacenet.data.images import write_png
from duospacenet.runtime import Camera, Frame, GroundTruth

INTRINSICS = [[10.0, 0.0, 8.0], [0.0, 10.0, 4.0], [0.0, 0.0, 1.0]]
LOOKING_FORWARD = [[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 1.5], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
POSE_AT_ORIGIN = np.eye(4).tolist()
CALIBRATION = {"width_px": 16, "height_px": 8, "intrinsics_px": INTRINSICS, "camera_T_ego": LOOKING_FORWARD}
EXAMPLE_SCENE: dict[str, Any] = {
    "schema_version": 1,
    "scene": "yard",
    "cameras": {"LEFT": CALIBRATION, "RIGHT": CALIBRATION},
    "frames": [
        {
            "timestamp_s": 10.0,
            "token": "first",
            "global_T_ego": POSE_AT_ORIGIN,
            "cameras": {"LEFT": {"image": "left.png"}, "RIGHT": {"image": None}},
        },
        {
            "timestamp_s": 10.5,
            "scene": "street",
            "global_T_ego": POSE_AT_ORIGIN,
            "cameras": {"RIGHT": {"image": "right.png", "width_px": 8}},
            "boxes": [
                {
                    "class": "car",
                    "center_m": [1, 2, 3],
                    "size_wlh_m": [4, 5, 6],
                    "yaw_rad": 0.7,
                    "velocity_m_s": [8, 9],
                }
            ],
            "maps": {"drivable_area": "mask.png"},
        },
    ],
}
LEFT_IMAGE = np.arange(16 * 8 * 3, dtype=np.uint8).reshape(8, 16, 3)
RIGHT_IMAGE = LEFT_IMAGE[:, ::2] + 7
MASK = np.eye(5, 4, 1) > 0


def write_example_scene(folder: Path, **changes: Any) -> Path:
    """Write the example scene with its images. changes: replacements of its top-level fields."""
    folder.mkdir(parents=True, exist_ok=True)
    write_png(folder / "left.png", LEFT_IMAGE)
    write_png(folder / "right.png", np.ascontiguousarray(RIGHT_IMAGE))
    write_png(folder / "mask.png", MASK.astype(np.uint8))
    (folder / "scene.json").write_text(json.dumps({**EXAMPLE_SCENE, **changes}))
    return folder


def assert_frames_equal(one: Frame, other: Frame) -> None:
    """Assert that all fields are equal: images and numbers bit for bit, cameras in the same order."""
    assert (one.timestamp_s, one.scene, one.token) == (other.timestamp_s, other.scene, other.token)
    assert one.global_T_ego.tobytes() == other.global_T_ego.tobytes()
    assert list(one.cameras) == list(other.cameras)
    assert set(one.images) == set(other.images)
    for name, camera in one.cameras.items():
        assert_cameras_equal(camera, other.cameras[name])
        assert np.array_equal(one.images[name], other.images[name])  # None is equal only to None
    assert (one.ground_truth is None) == (other.ground_truth is None)
    if one.ground_truth is not None:
        assert_ground_truths_equal(one.ground_truth, other.ground_truth)


def assert_cameras_equal(one: Camera, other: Camera) -> None:
    assert (one.width_px, one.height_px) == (other.width_px, other.height_px)
    assert one.intrinsics_px.tobytes() == other.intrinsics_px.tobytes()
    assert one.camera_T_ego.tobytes() == other.camera_T_ego.tobytes()


def assert_ground_truths_equal(one: GroundTruth, other: GroundTruth) -> None:
    assert one.boxes.shape == other.boxes.shape
    assert one.boxes.tobytes() == other.boxes.tobytes()
    assert one.classes == other.classes
    assert set(one.maps) == set(other.maps)
    for name, mask in one.maps.items():
        assert mask.dtype == other.maps[name].dtype == np.bool_
        assert np.array_equal(mask, other.maps[name])
