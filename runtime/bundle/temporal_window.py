"""The temporal window in a bundle's manifest: its frames, and the rules of the history."""

import math
from typing import Annotated, Final, Literal

from pydantic import Field

from ..json_record import JsonRecord, PositiveFloat
from .schema_versions import Since

Count = Annotated[int, Field(strict=True, gt=0, le=256)]  # of frames or cameras

# Limits of the temporal window. nuScenes' key frames come at 2 Hz. No road vehicle drives 70 m/s or turns 180 degrees
# in a second, so a larger ego motion means that the poses belong to different drives.
NOMINAL_TIME_DELTA_S: Final = 0.5
LARGEST_TIME_DELTA_S: Final = 2.0
LARGEST_SPEED_M_S: Final = 70.0
LARGEST_TURN_RAD_S: Final = math.pi


class TemporalWindow(JsonRecord):
    """The number of frames that the decoder uses, and when the history of past frames is reset.

    num_frames: including the current frame.
    slots: "newest first": slot 0 is the current frame, slot 1 the last processed one.
    nominal_time_delta_s: usual time between two frames [s].
    largest_time_delta_s, largest_speed_m_s, largest_turn_rad_s: of the step from the last processed frame to the
        current one [s, m/s, rad/s].
    speed, turn: what is compared with `largest_speed_m_s` and `largest_turn_rad_s`.
    above_largest: what happens if one of the three is exceeded. A value that is exactly the largest is not above it.
    new_scene: what happens if the scene's name changes. The time stamp may then be older.
    time_stamp_not_later: what happens in the same scene if the time stamp is equal or older.
    frame_without_images: "skip": no output, and the history stays as it is, even if the frame required a reset.

    The rules without numbers were the same in every schema. Since schema 5 they are in the file.
    """

    num_frames: Count
    slots: Annotated[Literal["newest first"], Since(5)] = "newest first"
    nominal_time_delta_s: PositiveFloat
    largest_time_delta_s: PositiveFloat
    largest_speed_m_s: PositiveFloat
    largest_turn_rad_s: Annotated[PositiveFloat, Since(2)] = LARGEST_TURN_RAD_S
    speed: Annotated[Literal["3D distance / time step"], Since(5)] = "3D distance / time step"
    turn: Annotated[Literal["3D rotation angle / time step"], Since(5)] = "3D rotation angle / time step"
    above_largest: Annotated[Literal["reset"], Since(5)] = "reset"
    new_scene: Annotated[Literal["reset"], Since(5)] = "reset"
    time_stamp_not_later: Annotated[Literal["refuse"], Since(5)] = "refuse"
    frame_without_images: Annotated[Literal["skip"], Since(5)] = "skip"
