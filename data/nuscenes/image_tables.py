"""The tables sensor, calibrated_sensor, sample_data and ego_pose: the images of the frames, and all poses."""

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...runtime.printable import shortened
from .frame_tables import Frames
from .index_records import CALIBRATION
from .poses import Poses, check_poses, check_upright
from .table import NumberedRow, Place, Table, dangling_error, repeated_error, row_error
from .table_records import CalibratedSensorRow, EgoPoseRow, SampleDataRow, SensorRow
from .table_set import TableSet

REFERENCE_SENSOR = "LIDAR_TOP"  # its time stamp and ego pose are those of the frame
# The order of nuScenes' cameras in mmdetection3d. Others come after them, in ascending order.
USUAL_CAMERAS = ("CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")

Array = NDArray[np.float64]


class Images(NamedTuple):
    """The images of all key frames, sorted by frame, then by camera; and the poses of the frames.

    camera_names: of the root.
    frames, cameras, calibration_numbers: (I,) numbers of the frame, the camera and the calibration of each image.
    file_names: of the I images, relative to the root.
    image_poses: ego poses at the times of the I images.
    calibrations: array of CALIBRATION.
    frame_poses: ego poses of the F frames.
    frame_times_us: (F,), of the reference sensor.
    """

    camera_names: list[str]
    frames: NDArray[np.int64]
    cameras: NDArray[np.int64]
    calibration_numbers: NDArray[np.int64]
    file_names: list[str]
    image_poses: Poses
    calibrations: NDArray
    frame_poses: Poses
    frame_times_us: Array


class _CalibratedSensor(NamedTuple):
    channel: str
    is_camera: bool
    numbered: NumberedRow[CalibratedSensorRow]


@dataclass
class _KeyFrameData:
    """The rows of sample_data that are key frames of cameras, and those of the reference sensor.

    pose_numbers: by token of the ego pose. pose_users: the row of sample_data that names it first.
    """

    frames: list[int] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)
    calibrations: list[int] = field(default_factory=list)
    poses: list[int] = field(default_factory=list)
    file_names: list[str] = field(default_factory=list)
    places: list[Place] = field(default_factory=list)
    calibration_keys: dict[tuple[str, int, int], int] = field(default_factory=dict)
    pose_numbers: dict[str, int] = field(default_factory=dict)
    pose_users: list[Place] = field(default_factory=list)
    reference: dict[int, tuple[int, float, int]] = field(default_factory=dict)  # pose, time, row by frame

    def pose_number(self, numbered: NumberedRow[SampleDataRow]) -> int:
        """Return the number of the ego pose that a row names."""
        number = self.pose_numbers.setdefault(numbered.row.ego_pose_token, len(self.pose_users))
        if number == len(self.pose_users):
            self.pose_users.append(numbered.place)
        return number


def read_images(tables: TableSet, frames: Frames) -> Images:
    """Raises InputError, naming the table, the row and the token."""
    sensors = _read_sensors(tables)
    path, data = _read_sample_data(tables, frames, sensors)
    poses = _read_ego_poses(tables, path, data)
    names = _camera_order(set(data.channels))
    numbers = {name: number for number, name in enumerate(names)}
    order = np.lexsort(([numbers[channel] for channel in data.channels], data.frames)).tolist()
    cameras = np.array([numbers[data.channels[each]] for each in order], np.int64)
    image_frames = np.array(data.frames, np.int64)[order]
    _check_one_image_per_camera(path, data, order, image_frames, cameras)
    image_poses = np.array(data.poses, np.int64)[order]
    frame_poses = np.array([data.reference[frame][0] for frame in range(len(frames.places))], np.int64)
    return Images(
        names,
        image_frames,
        cameras,
        np.array(data.calibrations, np.int64)[order],
        [data.file_names[each] for each in order],
        Poses(poses.translations[image_poses], poses.rotations[image_poses]),
        _calibrations(data, sensors),
        Poses(poses.translations[frame_poses], poses.rotations[frame_poses]),
        np.array([data.reference[frame][1] for frame in range(len(frames.places))], np.float64),
    )


def _read_sensors(tables: TableSet) -> dict[str, _CalibratedSensor]:
    """Return the calibrated sensors by token."""
    sensors = tables.open("sensor", SensorRow)
    channels = {token: (sensors.check_name(row, "channel"), row.row) for token, row in sensors.by_token().items()}
    table = tables.open("calibrated_sensor", CalibratedSensorRow)
    calibrated = {}
    for token, numbered in table.by_token().items():
        channel, sensor = table.find(numbered, "sensor_token", channels, "sensor")
        is_camera = sensor.modality == "camera"
        if is_camera:
            _check_camera(table, numbered)
        calibrated[token] = _CalibratedSensor(channel, is_camera, numbered)
    return calibrated


def _check_camera(table: Table[CalibratedSensorRow], numbered: NumberedRow[CalibratedSensorRow]) -> None:
    row = numbered.row
    if len(row.camera_intrinsic) != 3:
        message = f"expected camera_intrinsic as a 3x3 matrix; got {len(row.camera_intrinsic)} rows"
        raise row_error(table.path, numbered.place, message)
    if any(row.camera_distortion or ()):
        message = f"expected images without lens distortion; got camera_distortion {shortened(row.camera_distortion)}"
        raise row_error(table.path, numbered.place, f"{message}. Rectify the images")
    pose = Poses(np.array([row.translation]), np.array([row.rotation]))
    check_poses(table.path, pose, lambda _: numbered.place)


def _read_sample_data(
    tables: TableSet, frames: Frames, sensors: dict[str, _CalibratedSensor]
) -> tuple[Path, _KeyFrameData]:
    table = tables.open("sample_data", SampleDataRow)
    data = _KeyFrameData()
    for numbered in tables.rows(table):
        if numbered.row.is_key_frame:
            frame = table.find(numbered, "sample_token", frames.numbers, "sample")
            sensor = table.find(numbered, "calibrated_sensor_token", sensors, "calibrated_sensor")
            if sensor.is_camera:
                _add_image(table, numbered, data, frame, sensor)
            elif sensor.channel == REFERENCE_SENSOR:
                _add_reference(table, numbered, data, frame)
    for frame in range(len(frames.places)):
        if frame not in data.reference:
            raise row_error(
                frames.path,
                frames.places[frame],
                f"expected a key frame of {REFERENCE_SENSOR} in the table sample_data, for the ego pose; got none",
            )
    return table.path, data


def _add_image(
    table: Table[SampleDataRow],
    numbered: NumberedRow[SampleDataRow],
    data: _KeyFrameData,
    frame: int,
    sensor: _CalibratedSensor,
) -> None:
    row = numbered.row
    file_name = table.check_name(numbered, "filename")
    if not _is_inside(file_name):
        raise row_error(table.path, numbered.place, f"expected a file inside the root; got {file_name!r}")
    if not row.width or not row.height:
        message = f"expected the width and height of the image; got {row.width} and {row.height}"
        raise row_error(table.path, numbered.place, message)
    key = (row.calibrated_sensor_token, row.width, row.height)
    data.calibrations.append(data.calibration_keys.setdefault(key, len(data.calibration_keys)))
    data.frames.append(frame)
    data.channels.append(sensor.channel)
    data.poses.append(data.pose_number(numbered))
    data.file_names.append(file_name)
    data.places.append(numbered.place)


def _is_inside(file_name: str) -> bool:
    """Whether a path is inside the root by its text. Links are not resolved."""
    parts = Path(os.path.normpath(file_name)).parts
    return len(parts) > 0 and parts[0] not in ("/", "//", "..")


def _add_reference(
    table: Table[SampleDataRow], numbered: NumberedRow[SampleDataRow], data: _KeyFrameData, frame: int
) -> None:
    number, row = numbered
    first = data.reference.setdefault(frame, (data.pose_number(numbered), row.timestamp, number))
    if first[2] != number:
        raise repeated_error(table.path, numbered.place, first[2], f"key frame of {REFERENCE_SENSOR}")


def _read_ego_poses(tables: TableSet, sample_data: Path, data: _KeyFrameData) -> Poses:
    """Return the ego poses that are needed, by number."""
    table = tables.open("ego_pose", EgoPoseRow)
    count = len(data.pose_users)
    poses = Poses(np.zeros((count, 3)), np.zeros((count, 4)))
    places: list[Place | None] = [None] * count
    for numbered in tables.rows(table):
        row = numbered.row
        pose = data.pose_numbers.get(row.token)
        if pose is not None:
            place = places[pose]
            if place is not None:
                raise repeated_error(table.path, numbered.place, place[0])
            places[pose] = numbered.place
            poses.translations[pose], poses.rotations[pose] = row.translation, row.rotation
    found = [place for place in places if place is not None]
    if len(found) < count:
        pose = places.index(None)
        named = next(token for token, number in data.pose_numbers.items() if number == pose)
        raise dangling_error(sample_data, data.pose_users[pose], "ego_pose_token", named, "ego_pose")
    check_poses(table.path, poses, found.__getitem__)
    check_upright(table.path, poses, found)
    return poses


def _check_one_image_per_camera(
    path: Path, data: _KeyFrameData, order: list[int], frames: NDArray[np.int64], cameras: NDArray[np.int64]
) -> None:
    same = np.flatnonzero((np.diff(frames) == 0) & (np.diff(cameras) == 0))
    if len(same):
        first, second = data.places[order[same[0]]], data.places[order[same[0] + 1]]
        raise repeated_error(path, second, first[0], "camera of a key frame")


def _camera_order(names: set[str]) -> list[str]:
    return [*(name for name in USUAL_CAMERAS if name in names), *sorted(names.difference(USUAL_CAMERAS))]


def _calibrations(data: _KeyFrameData, sensors: dict[str, _CalibratedSensor]) -> NDArray:
    rows = np.zeros(len(data.calibration_keys), CALIBRATION)
    for (token, width_px, height_px), number in data.calibration_keys.items():
        row = sensors[token].numbered.row
        rows[number] = (row.camera_intrinsic, row.translation, row.rotation, width_px, height_px)
    return rows
