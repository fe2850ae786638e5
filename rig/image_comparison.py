"""Comparison of the images of a recording with each other and with the poses: stale, exchanged and turned cameras."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Frame
from .findings import Finding, NotJudged
from .image_directions import ImageDirections
from .image_features import Features, find_features
from .image_motion import ImageMotion
from .image_overlaps import ImageOverlaps
from .motion_steps import distance_between_m, turn_between_rad
from .requirements import RigRequirements
from .stale_input import StaleInput

LEAST_MOTION_M, LEAST_TURN_DEG = 1.0, 3.0  # between frames whose overlaps are compared

Images = Mapping[str, NDArray[np.uint8] | None]


class ImageComparison:
    """Takes the frames of a recording in order, and compares the images of some of them.

    cameras: names of the cameras whose calibrations have no finding. Only their directions are compared.
    compared: indices of the frames whose images are compared in detail.
    """

    def __init__(self, requirements: RigRequirements, cameras: Iterable[str], compared: Iterable[int]) -> None:
        self._stale = StaleInput(requirements)
        self._cameras, self._compared = list(cameras), set(compared)
        self._overlaps, self._motion = ImageOverlaps(), ImageMotion()
        self._before: tuple[Frame, Mapping[str, Features]] | None = None
        self._overlapped: Frame | None = None  # the last frame with overlaps

    def add(self, index: int, frame: Frame, images: Images) -> None:
        """Add the next frame. Its time and pose must be valid. images: those that fit their calibrations, by camera."""
        self._stale.add(index, replace(frame, images=images))
        if index not in self._compared:
            return
        features = {
            name: find_features(image) for name, image in images.items() if name in self._cameras and image is not None
        }
        if self._overlapped is None or has_moved(self._overlapped, frame):
            self._overlaps.add(frame.cameras, features)
            self._overlapped = replace(frame, images={})
        if self._before is not None:
            self._motion.add(self._before[0], frame, (self._before[1], features))
        self._before = replace(frame, images={}), features

    def findings(
        self, poses_are_right: bool, excluded: Collection[str] = ()
    ) -> tuple[list[tuple[str, Finding]], list[Finding], list[NotJudged]]:
        """The findings by camera, those about the poses and all cameras together, and what could not be judged.

        excluded: cameras with wrong image files.
        poses_are_right: whether the times and poses have no finding. Otherwise, no camera is judged by the motion.
        """
        stale = self._stale.camera_findings()
        wrong = {*excluded, *(name for name, _ in stale)}
        cameras = [name for name in self._cameras if name not in wrong]
        drive = self._stale.drive_findings()
        if poses_are_right and not drive:
            drive = ImageDirections(self._overlaps, self._motion, cameras).drive_findings()
        motion = self._motion if poses_are_right and not drive else ImageMotion()
        directions = ImageDirections(self._overlaps, motion, cameras)
        # Images that were given again count many times, and so do chance matches between them.
        are_frozen = any(finding.subject == "images" for finding in drive)
        found = stale if are_frozen else [*stale, *directions.camera_findings()]
        return found, drive, directions.not_judged() if self._compared else []


def has_moved(before: Frame, after: Frame) -> bool:
    """Whether the vehicle has moved or turned enough to see other things.

    A parked vehicle sees the same things, and the same chance matches, again and again.
    """
    poses = before.global_T_ego, after.global_T_ego
    return distance_between_m(*poses) >= LEAST_MOTION_M or np.degrees(turn_between_rad(*poses)) >= LEAST_TURN_DEG
