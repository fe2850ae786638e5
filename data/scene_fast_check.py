"""A fast check of the numbers in `scene.json`, many frames at once.

It only finds the first frames that may be wrong. `SceneFolder` examines the frames from there on one by one, and
describes what is wrong. So the limits here are those of `runtime.validation`, or stricter.
"""

import os
from array import array
from typing import Any, NamedTuple

import numpy as np
from msgspec import UNSET
from numpy.typing import NDArray

from ..runtime.calibration_limits import LATEST_S, are_intrinsics_possible, are_rigid
from .scene_records import Calibration, CameraInFrame, FrameInScene, Matrix3, Matrix4, SceneHeader, value_or

_Fields = tuple[Any, ...]  # width, height, intrinsics and extrinsics; None or UNSET if not given


FRAMES_AT_ONCE = 1000


class Suspects(NamedTuple):
    """The first frame that may be wrong, or the number of frames if none is.

    first_path: with a path that may lead out of the folder.
    first_number: with an impossible number, a wrong time, or an incomplete calibration.
    """

    first_path: int = 0
    first_number: int = 0


class FastCheck:
    """Checks the frames of a scene. Their numbers are collected, and checked many at once."""

    def __init__(self, header: SceneHeader) -> None:
        self._header = header
        self._shared = value_or(header.cameras, {})
        self._num_frames = 0
        self._first_path: int | None = None
        self._first_number: int | None = None
        self._last: tuple[str, float] | None = None
        self._previous: dict[str, _Fields] = {}
        self._poses, self._calibrations = _Poses(), _Calibrations()
        for camera in self._shared.values():
            self._calibrations.add_camera(0, *_fields(camera))

    def add(self, frame: FrameInScene) -> None:
        """Check the next frame of the scene."""
        number = self._num_frames
        if self._first_path is None and any(map(_may_lead_outside, _paths(frame))):
            self._first_path = number
        if not self._is_in_order(frame):
            self._add_suspect(number)
        self._poses.add(number, frame.global_T_ego)
        for name, camera in frame.cameras.items():
            own, shared = _fields(camera), self._shared.get(name)
            if own == self._previous.get(name):  # and was checked in an earlier frame
                continue
            self._previous[name] = own
            if shared is None or any(map(_is_given, own)):
                merged = own if shared is None else _merge(own, _fields(shared))
                if all(map(_is_given, merged)):
                    self._calibrations.add_camera(number, *merged)
                else:
                    self._add_suspect(number)
        self._num_frames += 1
        if self._num_frames % FRAMES_AT_ONCE == 0:
            self._check_numbers()

    def suspects(self) -> Suspects:
        """Return the result for the frames so far."""
        self._check_numbers()
        firsts = (self._first_path, self._first_number)
        return Suspects(*(self._num_frames if first is None else first for first in firsts))

    def _is_in_order(self, frame: FrameInScene) -> bool:
        """Whether the time of a frame is possible and later than the one before, and the frame has cameras."""
        place = value_or(frame.scene, self._header.scene), frame.timestamp_s
        last, self._last = self._last, place
        is_later = last is None or last[0] != place[0] or last[1] < place[1]
        return is_later and abs(frame.timestamp_s) <= LATEST_S and (len(self._shared) > 0 or len(frame.cameras) > 0)

    def _check_numbers(self) -> None:
        """Check the numbers that were collected, and forget them."""
        for number in (*self._poses.suspects(), *self._calibrations.suspects()):
            self._add_suspect(number)
        self._poses, self._calibrations = _Poses(), _Calibrations()

    def _add_suspect(self, number: int) -> None:
        self._first_number = number if self._first_number is None else min(number, self._first_number)


class _Poses:
    """Transforms, row by row, in memory that needs no Python objects."""

    def __init__(self) -> None:
        self._frames = array("q")
        self._values = array("d")

    def add(self, frame: int, a_T_b: Matrix4) -> None:
        self._frames.append(frame)
        for row in a_T_b:
            self._values.extend(row)

    def are_possible(self) -> NDArray[np.bool_]:
        return are_rigid(np.frombuffer(self._values, np.float64).reshape(-1, 4, 4))

    def suspects(self) -> list[int]:
        """Return the frames of the transforms that `runtime.validation` would refuse."""
        return np.frombuffer(self._frames, np.int64)[~self.are_possible()].tolist()


class _Calibrations(_Poses):
    """Calibrations, row by row."""

    def __init__(self) -> None:
        super().__init__()
        self._sizes = array("d")
        self._intrinsics = array("d")

    def add_camera(
        self, frame: int, width_px: int, height_px: int, intrinsics_px: Matrix3, camera_T_ego: Matrix4
    ) -> None:
        self.add(frame, camera_T_ego)
        self._sizes.extend((width_px, height_px))
        for row in intrinsics_px:
            self._intrinsics.extend(row)

    def are_possible(self) -> NDArray[np.bool_]:
        intrinsics = np.frombuffer(self._intrinsics, np.float64).reshape(-1, 3, 3)
        sizes = np.frombuffer(self._sizes, np.float64).reshape(-1, 2)
        return are_intrinsics_possible(intrinsics, sizes) & super().are_possible()


def _is_given(value: object) -> bool:
    return value is not None and value is not UNSET


def _merge(own: _Fields, shared: _Fields) -> _Fields:
    """Return the fields of a calibration: a frame's own, or else those of the scene."""
    return tuple(value if _is_given(value) else other for value, other in zip(own, shared, strict=True))


def _fields(camera: Calibration | CameraInFrame) -> _Fields:
    return camera.width_px, camera.height_px, camera.intrinsics_px, camera.camera_T_ego


def _paths(frame: FrameInScene) -> list[str]:
    images = [camera.image for camera in frame.cameras.values() if camera.image is not None]
    return [*images, *value_or(frame.maps, {}).values()]


def _may_lead_outside(path: str) -> bool:
    """Whether a path may lead out of its folder by its text. Links are not resolved."""
    return path.startswith(os.sep) or ".." in path
