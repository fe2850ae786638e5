"""The JSON schema of `scene.json`.

The scene's `cameras` give the calibration of all frames. A frame can override single fields, or give all of them. If a
camera is listed by the scene but not by a frame, it is lost in that frame. Paths are relative to the folder of
`scene.json`.
"""

from typing import Annotated

from pydantic import BeforeValidator, Field

from ..runtime.json_record import FiniteFloat, FirstVersion, JsonRecord, Name, PositiveFloat, PositiveInt
from .distortion_fields import refuse_distortion

SCHEMA_VERSION = 1
SCENE_NAME = "scene.json"
CALIBRATION_FIELDS = ("width_px", "height_px", "intrinsics_px", "camera_T_ego")

Row3 = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Row4 = tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
Matrix3 = tuple[Row3, Row3, Row3]
Matrix4 = tuple[Row4, Row4, Row4, Row4]


class CalibrationRecord(JsonRecord):
    """The calibration of a camera for the whole scene. The fields are those of `Camera`."""

    width_px: PositiveInt
    height_px: PositiveInt
    intrinsics_px: Matrix3
    camera_T_ego: Matrix4


class CameraRecord(JsonRecord):
    """A camera in one frame.

    image: path of the image file, or null for a lost camera.
    Other fields override the scene's calibration of this camera.
    """

    image: Name | None
    width_px: PositiveInt | None = None
    height_px: PositiveInt | None = None
    intrinsics_px: Matrix3 | None = None
    camera_T_ego: Matrix4 | None = None


class BoxRecord(JsonRecord):
    """A ground-truth object in the ego frame of its frame.

    velocity_m_s: over ground, or null if unknown.
    num_points: number of lidar and radar points in the box, or null if unknown.
    attribute: the nuScenes attribute, such as `vehicle.moving`; empty if the object has none, or null if unknown.
    """

    name: Name = Field(alias="class")
    center_m: Row3
    size_wlh_m: tuple[PositiveFloat, PositiveFloat, PositiveFloat]
    yaw_rad: FiniteFloat
    velocity_m_s: tuple[FiniteFloat, FiniteFloat] | None
    num_points: Annotated[int, Field(strict=True, ge=0, le=10**9)] | None = None
    attribute: Name | None = None


class FrameRecord(JsonRecord):
    """One frame.

    boxes: ground-truth objects; null or absent if unknown.
    maps: paths of PNG masks by map class; row i of a mask is x_i (forward), column j is y_j (left).
    """

    timestamp_s: FiniteFloat
    token: Name = ""
    scene: Name | None = None
    global_T_ego: Matrix4
    cameras: dict[Name, Annotated[CameraRecord, BeforeValidator(refuse_distortion)]]
    boxes: tuple[BoxRecord, ...] | None = None
    maps: dict[Name, Name] = Field(default_factory=dict)


class SceneRecord(JsonRecord):
    """The content of `scene.json`.

    scene: name of the scene, for frames that do not name their own.
    class_mapping: the class that a name in `boxes` stands for; null leaves out the boxes of that name.
    """

    schema_version: FirstVersion
    scene: Name
    cameras: dict[Name, Annotated[CalibrationRecord, BeforeValidator(refuse_distortion)]] = Field(default_factory=dict)
    class_mapping: dict[Name, Name | None] = Field(default_factory=dict)
    frames: Annotated[tuple[FrameRecord, ...], Field(min_length=1)]
