"""Mirrored frames: the same drive with left and right exchanged."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...runtime.frame import Camera, Frame, GroundTruth

MIRROR_Y = np.diag([1.0, -1.0, 1.0, 1.0])  # of the ego frame and the global frame
MIRROR_X = np.diag([-1.0, 1.0, 1.0, 1.0])  # of a camera frame, where x is right


def mirror_frame(frame: Frame) -> Frame:
    """Mirror a frame at the vertical plane through the ego's x axis: y becomes -y.

    Images, calibrations, pose, boxes and maps are mirrored. The result is exact: it is what a mirrored rig would record
    in a mirrored world. The cameras keep their names: the mirrored CAM_FRONT_LEFT looks to the front right. The masks
    must cover a range that is symmetric in y.
    """
    images = {name: None if image is None else _flipped(image) for name, image in frame.images.items()}
    cameras = {name: _mirror_camera(camera) for name, camera in frame.cameras.items()}
    ground_truth = None if frame.ground_truth is None else mirror_ground_truth(frame.ground_truth)
    pose = MIRROR_Y @ frame.global_T_ego @ MIRROR_Y
    return replace(frame, images=images, cameras=cameras, global_T_ego=pose, ground_truth=ground_truth)


def mirror_ground_truth(ground_truth: GroundTruth) -> GroundTruth:
    """Mirror boxes (y, yaw and vy change sign) and masks (the columns are reversed)."""
    boxes = ground_truth.boxes.copy()
    boxes[:, [1, 6, 8]] *= -1
    return replace(ground_truth, boxes=boxes, maps=_mirror_maps(ground_truth.maps))


def _mirror_maps(maps: Mapping[str, NDArray[np.bool_]]) -> dict[str, NDArray[np.bool_]]:
    return {name: _flipped(mask) for name, mask in maps.items()}


def _mirror_camera(camera: Camera) -> Camera:
    """Mirror a calibration. A pixel at x moves to width - x; the camera's x axis is mirrored, so it stays right."""
    intrinsics = camera.intrinsics_px.copy()
    intrinsics[0, 1] *= -1
    intrinsics[0, 2] = camera.width_px - intrinsics[0, 2]
    return replace(camera, intrinsics_px=intrinsics, camera_T_ego=MIRROR_X @ camera.camera_T_ego @ MIRROR_Y)


def _flipped(values: NDArray) -> NDArray:
    """Reverse the columns (second axis)."""
    return np.ascontiguousarray(values[:, ::-1])
