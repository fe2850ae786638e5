"""The rows of a scene that describe its sensors: calibration, ego poses, samples and their files."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...runtime.geometry import inverse, quaternion_from_rotation, rigid_transform, rotation_z
from ..nuscenes_rig import MOUNTS
from .root_scene import RootScene, SceneFrame
from .root_tables import RootTables, Row, make_token
from .sensor_times import LIDAR

Array = NDArray[np.float64]

EGO_T_LIDAR = rigid_transform(rotation_z(-np.pi / 2), [0.94, 0.0, 1.84])  # x of the lidar points to the right
JPEG_QUALITY = 92


class SensorRows:
    """Adds the rows of one scene's sensors to the tables, and writes the images.

    The rows of each sensor are linked in time by `prev` and `next`. The lidar has a sweep between two key frames too,
    as an example of rows that belong to no key frame.
    """

    def __init__(self, tables: RootTables, folder: Path, name: str, scene: RootScene) -> None:
        """folder: of the root.
        name: of the scene.
        """
        self._tables = tables
        self._folder = folder
        self._name = name
        self._scene = scene
        self._last: dict[str, Row] = {}  # the newest row of sample_data of each sensor
        self._calibrated = {LIDAR: self._add_calibration(LIDAR, EGO_T_LIDAR, [])}
        for channel, camera in scene.cameras.items():
            ego_T_camera = inverse(camera.camera_T_ego)
            self._calibrated[channel] = self._add_calibration(channel, ego_T_camera, camera.intrinsics_px.tolist())

    def add_frame(self, index: int, sample_token: str, frame: SceneFrame) -> None:
        """Add the rows of a key frame and write its images."""
        time_us = self._scene.times.key_frames_us[index]
        if index:
            previous_us = self._scene.times.key_frames_us[index - 1]
            self._add_data(LIDAR, sample_token, (previous_us + time_us) // 2, b"", is_key_frame=False)
        self._add_data(LIDAR, sample_token, time_us, b"")
        for channel, camera_us in self._scene.times.of_cameras(index).items():
            image = frame.rendered[channel].image
            _, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
            height, width = image.shape[:2]
            self._add_data(channel, sample_token, camera_us, data.tobytes(), width=width, height=height)

    def _add_calibration(self, channel: str, ego_T_sensor: Array, intrinsics_px: list[list[float]]) -> str:
        token = make_token("calibrated_sensor", self._name, channel)
        self._tables.add(
            "calibrated_sensor",
            token=token,
            sensor_token=make_token("sensor", channel),
            **_pose(ego_T_sensor),
            camera_intrinsic=intrinsics_px,
        )
        return token

    def _add_data(
        self,
        channel: str,
        sample_token: str,
        timestamp_us: int,
        data: bytes,
        is_key_frame: bool = True,
        width: int = 0,
        height: int = 0,
    ) -> None:
        """Write a file of a sensor, and add its row of sample_data and its ego pose."""
        token = make_token("sample_data", self._name, channel, timestamp_us)
        previous = self._last.get(channel)
        kind, suffix = ("samples" if is_key_frame else "sweeps"), ("pcd.bin" if channel == LIDAR else "jpg")
        filename = f"{kind}/{channel}/{self._name}__{channel}__{timestamp_us}.{suffix}"
        path = self._folder / filename
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
        pose = _pose(self._scene.global_T_ego(timestamp_us))
        self._tables.add("ego_pose", token=token, timestamp=timestamp_us, **pose)
        self._last[channel] = self._tables.add(
            "sample_data",
            token=token,
            sample_token=sample_token,
            ego_pose_token=token,
            calibrated_sensor_token=self._calibrated[channel],
            timestamp=timestamp_us,
            fileformat="pcd" if channel == LIDAR else "jpg",
            is_key_frame=is_key_frame,
            height=height,
            width=width,
            filename=filename,
            prev=previous["token"] if previous else "",
            next="",
        )
        if previous:
            previous["next"] = token


def add_sensors(tables: RootTables) -> None:
    """Add the rows of the table `sensor`, which all scenes share."""
    for channel in (LIDAR, *MOUNTS):
        modality = "lidar" if channel == LIDAR else "camera"
        tables.add("sensor", token=make_token("sensor", channel), channel=channel, modality=modality)


def _pose(a_T_b: Array) -> dict[str, Any]:
    """A pose in the fields of the tables: translation [m] and rotation as a quaternion, w first."""
    return {
        "translation": a_T_b[:3, 3].tolist(),
        "rotation": quaternion_from_rotation(a_T_b[:3, :3]).tolist(),
    }
