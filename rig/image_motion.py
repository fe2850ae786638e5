"""Motion in the images of a camera, compared with the motion in the ego poses.

While the vehicle moves, everything that stands still moves in the image along epipolar lines, away from the direction
of motion. A camera that is turned, exchanged with another one, or on a vehicle with wrong poses sees other motions.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera, Frame
from ..runtime.geometry import inverse, rigid_transform, rotation_z
from .image_features import Features, Matches, match_features
from .motion_steps import distance_between_m, turn_between_rad
from .optics import pixel_rays

Array = NDArray[np.float64]

REST_M, REST_DEG = 0.05, 0.3  # between two poses of a vehicle that does not move
SHORTEST_STEP_M = 0.5  # the images move too little in shorter steps
LONGEST_STEP_M = 8.0  # features are not found again after longer steps
LEAST_MOTION_DEG = 0.6  # in the image: less motion, of distant things, has no reliable direction
LEAST_FORWARD_DEG = 0.3  # along the epipolar line
LARGEST_DEVIATION_DEG = 0.35  # from the epipolar line: poses lack the pitch and roll of the suspension


class Track(NamedTuple):
    """The matches of one camera between two frames, with its calibrations and the ego poses `global_T_ego`."""

    matches: Matches
    cameras: tuple[Camera, Camera]
    poses: tuple[Array, Array]


class MotionCount(NamedTuple):
    """agreeing: number of matches whose motion agrees with the poses. moving: number of matches that move."""

    agreeing: int
    moving: int


class ImageMotion:
    """The matches of each camera between frames, collected over some pairs of frames."""

    def __init__(self) -> None:
        self._tracks: dict[str, list[Track]] = {}
        self._at_rest = MotionCount(0, 0)

    def add(self, before: Frame, after: Frame, features: tuple[Mapping[str, Features], Mapping[str, Features]]) -> None:
        """Add two frames. They are only compared if they are of one scene, and neither too near nor too far apart.

        features: of their images, by camera.
        """
        poses = before.global_T_ego, after.global_T_ego
        distance_m = distance_between_m(*poses)
        is_at_rest = distance_m <= REST_M and np.degrees(turn_between_rad(*poses)) <= REST_DEG
        if before.scene != after.scene or not (is_at_rest or SHORTEST_STEP_M <= distance_m <= LONGEST_STEP_M):
            return
        for name in [name for name in features[0] if name in features[1]]:
            matches = match_features(features[0][name], features[1][name])
            track = Track(matches, (before.cameras[name], after.cameras[name]), poses)
            if is_at_rest:
                self._add_at_rest(track)
            else:
                self._tracks.setdefault(name, []).append(track)

    def count(self, name: str, yaw_deg: float = 0.0, calibration_of: str | None = None) -> MotionCount:
        """Count the matches of a camera that agree with the motion in the poses.

        yaw_deg: turns the camera on the vehicle to the left.
        calibration_of: use the calibration of this camera instead.
        """
        counts = np.zeros(2, np.int64)
        other = None if calibration_of is None else self._tracks.get(calibration_of, [])
        for index, track in enumerate(self._tracks.get(name, ())):
            if other is None:
                counts += _count(track, yaw_deg)
            elif index < len(other):
                counts += _count(track._replace(cameras=other[index].cameras), yaw_deg)
        return MotionCount(*counts.tolist())

    @property
    def at_rest(self) -> MotionCount:
        """The matches between frames with the same pose. Those that do not move in the image agree with it."""
        return self._at_rest

    @property
    def cameras(self) -> list[str]:
        """The cameras with images in two of the frames."""
        return list(self._tracks)

    def _add_at_rest(self, track: Track) -> None:
        before, after = (
            pixel_rays(camera, points) for camera, points in zip(track.cameras, track.matches, strict=True)
        )
        is_moving = np.degrees(np.linalg.norm(after - before, axis=1)) > LEAST_MOTION_DEG
        agreeing, moving = self._at_rest
        self._at_rest = MotionCount(agreeing + int((~is_moving).sum()), moving + int(is_moving.sum()))


def _count(track: Track, yaw_deg: float) -> tuple[int, int]:
    rays = [pixel_rays(camera, points) for camera, points in zip(track.cameras, track.matches, strict=True)]
    before, after = (pose @ _mount(camera, yaw_deg) for pose, camera in zip(track.poses, track.cameras, strict=True))
    after_T_before = inverse(after) @ before
    turned = rays[0] @ after_T_before[:3, :3].T
    motion = rays[1] - turned
    translation = after_T_before[:3, 3] / max(float(np.linalg.norm(after_T_before[:3, 3])), 1e-9)
    # A thing at rest moves from its direction towards that of the translation: away from where the vehicle goes.
    forward = _normalise(translation - (turned @ translation)[:, None] * turned)
    sideways = np.cross(turned, forward)
    along_deg, across_deg = np.degrees((motion * forward).sum(axis=1)), np.degrees((motion * sideways).sum(axis=1))
    is_moving = np.hypot(along_deg, across_deg) > LEAST_MOTION_DEG
    agrees = is_moving & (along_deg > LEAST_FORWARD_DEG) & (np.abs(across_deg) < LARGEST_DEVIATION_DEG)
    return int(agrees.sum()), int(is_moving.sum())


def _mount(camera: Camera, yaw_deg: float) -> Array:
    """`ego_T_camera` (4, 4) of a camera that is turned to the left at its place."""
    ego_T_camera = inverse(camera.camera_T_ego)
    return rigid_transform(rotation_z(np.radians(yaw_deg)) @ ego_T_camera[:3, :3], ego_T_camera[:3, 3])


def _normalise(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
