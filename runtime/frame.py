"""One frame of a camera rig: images, calibration, ego pose, time and, if known, ground truth."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Camera:
    """The calibration of one camera in one frame.

    intrinsics_px: (3, 3), in pixels of the image in `Frame.images`; the centre of the first pixel is at (0.5, 0.5).
    camera_T_ego: (4, 4), maps points from the ego frame (x forward, y left, z up) at the *frame's* time stamp to the
        camera frame (z forward, x right, y down). If the camera is triggered at another time than the frame, go
        through the global frame: `camera_T_ego = camera_T_global(camera's time) @ global_T_ego(frame's time)`.
    width_px, height_px: size of the image in `Frame.images`.
    """

    intrinsics_px: NDArray[np.float64]
    camera_T_ego: NDArray[np.float64]
    width_px: int
    height_px: int


@dataclass(frozen=True)
class GroundTruth:
    """The true objects and maps of one frame.

    boxes: (D, 9) in the ego frame: x y z w l h [m], yaw [rad], vx vy [m/s] over ground, NaN where unknown.
    classes: the annotated names of the D boxes: classes of the model, or names that stand for one.
    maps: (X, Y) bool by map class, over the model's perception range; `mask[i, j]` is the cell at x_i (forward),
        y_j (left).
    has_boxes: False if only maps are known. The list of boxes is then empty because they are unknown.
    num_points: (D,) number of lidar and radar points in each box, -1 where unknown; None if all are unknown. Boxes
        without points are left out of training and evaluation.
    attributes: the annotated nuScenes attribute of the D boxes, such as `vehicle.moving`, or "" for a box without one;
        None if they are unknown.
    class_mapping: the class that an annotated name stands for; None leaves out the boxes of that name. Names of
        nuScenes' raw annotations need no entry.
    """

    boxes: NDArray[np.float64]
    classes: tuple[str, ...]
    maps: Mapping[str, NDArray[np.bool_]] = field(default_factory=dict)
    has_boxes: bool = True
    num_points: NDArray[np.int64] | None = None
    attributes: tuple[str, ...] | None = None
    class_mapping: Mapping[str, str | None] = field(default_factory=dict)


@dataclass(frozen=True)
class Frame:
    """The images of all cameras at one time stamp, with calibration and ego pose.

    images: (height, width, 3) uint8 in BGR order by camera name, or None for a lost camera.
    cameras: calibration by the same names.
    global_T_ego: (4, 4), the ego pose at `timestamp_s`, in any fixed global frame.
    timestamp_s: seconds as float64. Only differences matter.
    scene: name of the scene. The history is reset between scenes.
    token: a name of the frame, copied to the results.
    ground_truth: true objects and maps, or None if unknown.
    """

    images: Mapping[str, NDArray[np.uint8] | None]
    cameras: Mapping[str, Camera]
    global_T_ego: NDArray[np.float64]
    timestamp_s: float
    scene: str = ""
    token: str = ""
    ground_truth: GroundTruth | None = None
