"""One moment of a rig: images, calibration, pose and time; and, where it is known, the truth about it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Camera:
    """One camera's calibration at one moment.

    intrinsics_px: (3, 3), pixels of the image as delivered, the first pixel's centre at (0.5, 0.5).
    camera_T_ego: (4, 4), from the ego frame at the *frame's* time stamp to the camera (z forward, x right,
        y down). A camera that is triggered at another time than the frame goes over the global frame:
        `camera_T_ego = camera_T_global(its own time) @ global_T_ego(the frame's time)`.
    """

    intrinsics_px: NDArray[np.float64]
    camera_T_ego: NDArray[np.float64]
    width_px: int
    height_px: int


@dataclass(frozen=True)
class GroundTruth:
    """What is known to be there.

    boxes: (D, 9) in the ego frame: x y z w l h [m], yaw [rad], vx vy [m/s] over ground, NaN where unknown.
    classes: D names.
    maps: by name, (X, Y) bool over the model's perception range; `mask[i, j]` is the cell at x_i (forward),
        y_j (left).
    has_boxes: False where maps alone are known: that there are no boxes then says nothing.
    """

    boxes: NDArray[np.float64]
    classes: tuple[str, ...]
    maps: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    has_boxes: bool = True


@dataclass(frozen=True)
class Frame:
    """What a rig delivers at one moment.

    images: by camera name, (height, width, 3) uint8 in BGR order, or None for a lost camera.
    cameras: calibration by the same names.
    global_T_ego: (4, 4), the ego pose at `timestamp_s`.
    timestamp_s: float64 seconds; only differences matter.
    scene: frames of different scenes share no history.
    token: the caller's own name of the frame; it is copied to the results.
    """

    images: Mapping[str, NDArray[np.uint8] | None]
    cameras: Mapping[str, Camera]
    global_T_ego: NDArray[np.float64]
    timestamp_s: float
    scene: str = ""
    token: str = ""
    ground_truth: GroundTruth | None = None
