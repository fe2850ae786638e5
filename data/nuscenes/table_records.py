"""The rows of the nuScenes tables, with the fields that this toolkit reads.

Other fields of a row are ignored. Lengths are metres, times are microseconds, quaternions are w first.
Source: the schema in nuscenes-devkit (docs/schema_nuscenes.md).
"""

from typing import Annotated

from msgspec import Meta, Struct

Vector3 = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Count = Annotated[int, Meta(ge=0, le=10**9)]
Length = Annotated[float, Meta(gt=0, le=1e6)]
Microseconds = Annotated[float, Meta(ge=-1e20, le=1e20)]
Pixels = Annotated[int, Meta(ge=0, le=10**6)]


class Row(Struct, frozen=True, gc=False):
    """A row of any table. token: its key."""

    token: str


class SceneRow(Row, frozen=True, gc=False):
    name: str
    log_token: str


class LogRow(Row, frozen=True, gc=False):
    """location: name of the map, such as `singapore-onenorth`."""

    location: str


class SensorRow(Row, frozen=True, gc=False):
    """modality: `camera`, `lidar` or `radar`."""

    channel: str
    modality: str


class CalibratedSensorRow(Row, frozen=True, gc=False):
    """The pose of a sensor in the ego frame, and the intrinsics [px] of a camera, which are empty for other sensors.

    camera_distortion: of dialects of the format; nuScenes' images are undistorted.
    """

    sensor_token: str
    translation: Vector3
    rotation: Quaternion
    camera_intrinsic: list[Vector3]
    camera_distortion: list[float] | None = None


class SampleRow(Row, frozen=True, gc=False):
    """A key frame."""

    timestamp: Microseconds
    scene_token: str


class SampleDataRow(Row, frozen=True, gc=False):
    """One measurement of one sensor. Only key frames are read.

    filename: relative to the root.
    """

    sample_token: str
    ego_pose_token: str
    calibrated_sensor_token: str
    timestamp: Microseconds
    is_key_frame: bool
    filename: str
    width: Pixels | None = None
    height: Pixels | None = None


class EgoPoseRow(Row, frozen=True, gc=False):
    """The ego pose in the global frame at the time of one measurement."""

    translation: Vector3
    rotation: Quaternion


class InstanceRow(Row, frozen=True, gc=False):
    """An object, which has one annotation in each key frame."""

    category_token: str


class NamedRow(Row, frozen=True, gc=False):
    """A category or an attribute."""

    name: str


class VisibilityRow(Row, frozen=True, gc=False):
    level: str


class AnnotationRow(Row, frozen=True, gc=False):
    """The box of an object in one key frame, in the global frame.

    size: width, length, height.
    prev, next: tokens of the annotations of the same object in the neighbouring key frames, or empty.
    """

    sample_token: str
    instance_token: str
    attribute_tokens: list[str]
    translation: Vector3
    size: tuple[Length, Length, Length]
    rotation: Quaternion
    prev: str
    next: str
    num_lidar_pts: Count
    num_radar_pts: Count
    visibility_token: str = ""
