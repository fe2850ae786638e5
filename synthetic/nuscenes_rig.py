"""The cameras of a synthetic drive: the nuScenes rig, with small random deviations."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera
from ..runtime.geometry import CAMERA_R_BODY, inverse, rigid_transform, rotation_z

Array = NDArray[np.float64]


class CameraMount(NamedTuple):
    """Position and direction of a camera in the ego frame, and its focal length for an image width of 1600 pixels."""

    position_m: tuple[float, float, float]
    yaw_deg: float
    focal_px: float


MOUNTS = {
    "CAM_FRONT": CameraMount((1.70, 0.02, 1.51), 0.0, 1266.0),
    "CAM_FRONT_RIGHT": CameraMount((1.55, -0.49, 1.50), -55.0, 1266.0),
    "CAM_FRONT_LEFT": CameraMount((1.52, 0.49, 1.51), 55.0, 1266.0),
    "CAM_BACK": CameraMount((0.03, 0.00, 1.57), 180.0, 809.0),
    "CAM_BACK_LEFT": CameraMount((1.04, 0.48, 1.59), 110.0, 1266.0),
    "CAM_BACK_RIGHT": CameraMount((1.02, -0.48, 1.56), -110.0, 1266.0),
}


def build_rig(seed: int, image_size: tuple[int, int]) -> dict[str, Camera]:
    """The six cameras by name, each with deviations of up to two degrees and 0.1 m from its nominal pose.

    seed: of the deviations.
    image_size: width and height [px]. The intrinsics are those of a 1600x900 image, scaled to this width and cropped at
        the top.
    """
    rng = np.random.default_rng([seed, 7])
    width, height = image_size
    scale = width / 1600
    cameras = {}
    for name, mount in MOUNTS.items():
        focal = mount.focal_px * scale * rng.uniform(0.985, 1.015)
        centre = (800 * scale, 491 * scale - (900 * scale - height)) + rng.uniform(-10, 10, 2) * scale
        intrinsics = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
        yaw, pitch, roll = np.radians((mount.yaw_deg, 0, 0) + rng.uniform(-1, 1, 3) * (2.0, 1.0, 1.0))
        position = mount.position_m + rng.uniform(-0.1, 0.1, 3)
        ego_R_camera = rotation_z(yaw) @ _pitch_and_roll(pitch, roll) @ CAMERA_R_BODY.T
        cameras[name] = Camera(intrinsics, inverse(rigid_transform(ego_R_camera, position)), width, height)
    return cameras


def _pitch_and_roll(pitch_rad: float, roll_rad: float) -> Array:
    """The rotation (3, 3) by the roll about x, followed by the rotation by the pitch about y (positive: nose down)."""
    cp, sp, cr, sr = np.cos(pitch_rad), np.sin(pitch_rad), np.cos(roll_rad), np.sin(roll_rad)
    return np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]]) @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
