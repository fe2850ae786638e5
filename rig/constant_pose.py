"""A constant ego pose, although the images show that the vehicle moves."""

from collections.abc import Mapping

import numpy as np

from ..runtime.frame import Frame
from .findings import Finding, Verdict
from .motion_steps import distance_between_m
from .thumbnails import Thumbnail, changed_share

LARGEST_STEP_M = 0.02  # a longer step between two frames is a motion
LARGEST_DISTANCE_M = 0.1  # from the reference frame; images of a creeping vehicle are not compared farther apart
LONGEST_TIME_S = 20.0  # the light may change the images of a parked vehicle in a longer time
LEAST_CHANGED_SHARE = 0.55  # of the images of at least half of the cameras
LEAST_CHANGES = 4  # a vehicle that starts, or a pose source that lags, has fewer
LEAST_CHANGES_OF_WHOLE = 2  # if the pose is constant in the whole recording
LARGEST_DEGREES = 180.0

SAME_POSE_CAUSE = "Likely cause: one pose was given for all these frames, or the pose source stopped."
GIVE_POSES = "Give the ego pose of each frame, in metres."


class ConstantPose:
    """Finds a constant pose in frames that come in order. Keeps one thumbnail per camera.

    The images of most cameras must change strongly again and again. Traffic around a parked vehicle changes only
    parts of them.
    """

    def __init__(self) -> None:
        self._before: Frame | None = None
        self._start = 0  # of the frames with a constant pose
        self._num_changes = 0
        self._reference: tuple[Frame, Mapping[str, Thumbnail]] | None = None
        self._has_moved = False  # before `_start`
        self._path_m = 0.0
        self._last = 0
        self._found: Finding | None = None

    def add(self, index: int, frame: Frame, thumbnails: Mapping[str, Thumbnail]) -> None:
        """Add the next frame. thumbnails: of its images, by camera; without lost cameras."""
        before, self._before, self._last = self._before, frame, index
        if before is None or before.scene != frame.scene or _distance_m(before, frame) > LARGEST_STEP_M:
            self._has_moved = self._has_moved or before is not None
            self._start, self._num_changes, self._path_m = index, 0, 0.0
            self._reference = (frame, thumbnails) if thumbnails else None
            return
        self._path_m += _distance_m(before, frame)
        if thumbnails:
            self._compare(frame, thumbnails)
        is_first = self._found is None or self._found.frame == self._start
        if self._num_changes >= LEAST_CHANGES and is_first:
            self._found = self._finding()

    def drive_findings(self, is_complete: bool = True) -> list[Finding]:
        """A finding if the pose is constant. is_complete: whether the last frame has been added."""
        if self._found is not None:
            return [self._found]
        is_whole = is_complete and not self._has_moved and self._num_changes >= LEAST_CHANGES_OF_WHOLE
        return [self._finding()] if is_whole else []

    def _compare(self, frame: Frame, thumbnails: Mapping[str, Thumbnail]) -> None:
        """Compare the images with those of the reference frame."""
        if self._reference is None:
            self._reference = frame, thumbnails
            return
        reference, images = self._reference
        shares = [changed_share(images[name], thumbnails[name]) for name in images if name in thumbnails]
        shares = [share for share in shares if np.isfinite(share)]
        has_changed = bool(shares) and float(np.median(shares)) >= LEAST_CHANGED_SHARE
        self._num_changes += has_changed
        is_far = _distance_m(reference, frame) > LARGEST_DISTANCE_M
        is_old = abs(float(frame.timestamp_s) - float(reference.timestamp_s)) > LONGEST_TIME_S
        if has_changed or is_far or is_old or not shares:
            self._reference = frame, thumbnails

    def _finding(self) -> Finding:
        got = "the same pose" if self._path_m == 0 else f"a motion of {self._path_m:.2g} m in total"
        return Finding(
            "ego pose",
            Verdict.SUSPECT,
            "poses that change as the images do",
            f"{got} in frames {self._start} to {self._last}, while the images of most cameras changed",
            self._cause(),
            GIVE_POSES,
            self._start,
            self._last - self._start + 1,
        )

    def _cause(self) -> str:
        if self._path_m == 0 or self._before is None:
            return SAME_POSE_CAUSE
        position = self._before.global_T_ego[:3, 3]
        if np.abs(position[:2]).max() <= LARGEST_DEGREES:
            return "Likely cause: positions in degrees of latitude and longitude, or in kilometres, instead of metres."
        return "Likely cause: the pose source stopped, or positions are not in metres."


def _distance_m(one: Frame, other: Frame) -> float:
    return distance_between_m(one.global_T_ego, other.global_T_ego)
