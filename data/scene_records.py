"""The records of `scene.json` for fast reading. Their fields are those of `scene_schema.py`, with the same types.

They are decoded about fifty times as fast, but errors are described by `scene_schema.py` only. A field that a file does
not have is UNSET, so that the keys of an object can be counted.
"""

from typing import Annotated, TypeVar

from msgspec import UNSET, Meta, Struct, UnsetType

LARGEST = 1e19  # larger numbers are left to the strict parser, which refuses integers of more than 64 bits

Float = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
PositiveFloat = Annotated[float, Meta(gt=0, le=LARGEST)]
PositiveInt = Annotated[int, Meta(gt=0, le=10**9)]
Count = Annotated[int, Meta(ge=0, le=10**9)]
Row3 = tuple[Float, Float, Float]
Row4 = tuple[Float, Float, Float, Float]
Matrix3 = tuple[Row3, Row3, Row3]
Matrix4 = tuple[Row4, Row4, Row4, Row4]

Value = TypeVar("Value")


class Record(Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """A JSON object with exactly the declared fields."""


class Calibration(Record, frozen=True, gc=False):
    width_px: PositiveInt
    height_px: PositiveInt
    intrinsics_px: Matrix3
    camera_T_ego: Matrix4


class CameraInFrame(Record, frozen=True, gc=False):
    image: str | None
    width_px: PositiveInt | UnsetType | None = UNSET
    height_px: PositiveInt | UnsetType | None = UNSET
    intrinsics_px: Matrix3 | UnsetType | None = UNSET
    camera_T_ego: Matrix4 | UnsetType | None = UNSET


class Box(Record, frozen=True, gc=False, rename={"name": "class"}):
    name: str
    center_m: Row3
    size_wlh_m: tuple[PositiveFloat, PositiveFloat, PositiveFloat]
    yaw_rad: Float
    velocity_m_s: tuple[Float, Float] | None
    num_points: Count | UnsetType | None = UNSET
    attribute: str | UnsetType | None = UNSET


class FrameInScene(Record, frozen=True, gc=False):
    timestamp_s: Float
    global_T_ego: Matrix4
    cameras: dict[str, CameraInFrame]
    token: str | UnsetType = UNSET
    scene: str | UnsetType | None = UNSET
    boxes: tuple[Box, ...] | UnsetType | None = UNSET
    maps: dict[str, str] | UnsetType = UNSET


class SceneHeader(Record, frozen=True, gc=False):
    """The fields of the scene, without its frames."""

    schema_version: Annotated[int, Meta(ge=1, le=1)]
    scene: str
    cameras: dict[str, Calibration] | UnsetType = UNSET
    class_mapping: dict[str, str | None] | UnsetType = UNSET


def value_or(value: Value | UnsetType | None, default: Value) -> Value:
    """Return a value, or `default` if it is null or absent."""
    return default if value is None or value is UNSET else value
