"""The boxes of a nuScenes submission file, as pydantic checks them: the field types, and the errors about them."""

import math
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field
from pydantic_core import PydanticCustomError

from ..runtime.attributes import ATTRIBUTES, NO_ATTRIBUTE
from ..runtime.json_record import FiniteFloat
from .class_names import DETECTION_CLASSES

LARGEST = 1e9  # of coordinates [m], sizes [m], velocities [m/s] and quaternions; their products must be finite


def _check_class(name: str) -> str:
    if name not in DETECTION_CLASSES:
        raise PydanticCustomError("class", f"expected one of {', '.join(DETECTION_CLASSES)}")
    return name


def _check_attribute(name: str) -> str:
    if name not in (*ATTRIBUTES, NO_ATTRIBUTE):
        raise PydanticCustomError("attribute", f'expected "", {", ".join(ATTRIBUTES)}')
    return name


def _check_rotation(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    if not 1 / LARGEST <= math.hypot(*quaternion) <= LARGEST:
        raise PydanticCustomError("rotation", f"expected a quaternion with a length from {1 / LARGEST} to {LARGEST}")
    return quaternion


def _check_velocity(value: float) -> float:
    if abs(value) > LARGEST:
        raise PydanticCustomError("velocity", "expected a number, or NaN if the velocity is unknown")
    return value


Coordinate = Annotated[float, Field(strict=True, ge=-LARGEST, le=LARGEST)]
Size = Annotated[float, Field(strict=True, gt=0, le=LARGEST)]
Velocity = Annotated[float, Field(strict=True), AfterValidator(_check_velocity)]
Rotation = Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat], AfterValidator(_check_rotation)]


class SubmittedBox(BaseModel):
    """One box of the file. Other fields are ignored, as the devkit does.

    num_pts: not needed, but `DetectionBox.serialize` writes it. The devkit leaves out boxes with 0 points.
    """

    model_config = ConfigDict(extra="ignore")

    sample_token: str
    translation: tuple[Coordinate, Coordinate, Coordinate]
    size: tuple[Size, Size, Size]
    rotation: Rotation
    velocity: tuple[Velocity, Velocity]
    detection_name: Annotated[str, AfterValidator(_check_class)]
    detection_score: FiniteFloat
    attribute_name: Annotated[str, AfterValidator(_check_attribute)]
    num_pts: Annotated[int, Field(strict=True)] = -1
