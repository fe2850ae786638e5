"""The coverage of a sequence of frames: the events in it, and those that it lacks for a parity check."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import get_args

import numpy as np
from numpy.typing import NDArray

from ...model import DuoSpaceNetConfig
from ...runtime import Frame
from ...runtime.bundle.temporal_window import TemporalWindow
from ...runtime.geometry import inverse, nearest_rigid
from ...runtime.history import ResetKind
from .expected_windows import reset_kind

MIN_FULL_WINDOWS = 3  # frames with a full window
MIN_MOTION = {"pitch_deg": 1.0, "roll_deg": 1.0, "yaw_deg": 5.0, "height_m": 0.1, "distance_m": 2.0}


@dataclass(frozen=True)
class Coverage:
    """The events in a sequence, from its frames and from the windows that the reset rules give.

    frames: number of frames. skipped: number of frames without any image.
    windows: number of frames by the length of their window.
    lost_cameras: by slot, the number of cameras that were lost there at least once.
    motion: largest motion between the current frame and a past frame of its window, by kind. `pitch_deg`, `roll_deg`
        and `yaw_deg` are angles [degrees], `height_m` and `distance_m` lengths [m].
    calibrations: number of different calibrations.
    resets: number of windows that were restarted, by reason: a new scene, a gap in time, an ego jump or turn.
    dropped_frames: number of frames after a gap that does not reset the history.
    """

    frames: int
    skipped: int
    windows: dict[int, int]
    lost_cameras: list[int]
    motion: dict[str, float]
    calibrations: int
    resets: dict[str, int]
    dropped_frames: int

    @classmethod
    def of(
        cls,
        frames: Sequence[Frame],
        windows: Sequence[Sequence[int]],
        config: DuoSpaceNetConfig,
        limits: TemporalWindow,
    ) -> "Coverage":
        """Measure a sequence.

        windows: from `expected_windows`.
        limits: the model's temporal window.
        """
        used = [window for window in windows if window]
        pairs = [(frames[window[0]], frames[past]) for window in used for past in window[1:]]
        steps = [(frames[before[0]], frames[now[0]]) for before, now in pairwise(used)]
        resets = [reset_kind(before, now, limits) for before, now in steps]
        return cls(
            frames=len(frames),
            skipped=len(windows) - len(used),
            windows=dict(sorted(Counter(map(len, used)).items())),
            lost_cameras=[len(_lost_in_slot(frames, used, slot)) for slot in range(config.num_frames)],
            motion=_largest_motion(pairs),
            calibrations=len({_calibration(frames[window[0]]) for window in used}),
            resets=dict(Counter(kind for kind in resets if kind)),
            dropped_frames=sum(
                kind is None and now.timestamp_s - before.timestamp_s > 1.5 * limits.nominal_time_delta_s
                for (before, now), kind in zip(steps, resets, strict=True)
            ),
        )

    def shortfalls(self, config: DuoSpaceNetConfig) -> list[str]:
        """The events that a parity check of this configuration needs and that are missing, one line each."""
        lines = []
        cameras, size = config.num_cameras, config.num_frames
        if cameras > 1:
            lines += [
                f"{count} of {cameras} cameras are lost in slot {slot}"
                for slot, count in enumerate(self.lost_cameras)
                if count < cameras
            ]
        if (full := self.windows.get(size, 0)) < MIN_FULL_WINDOWS:
            lines.append(f"{full} frames have a full window of {size} frames; expected at least {MIN_FULL_WINDOWS}")
        if size > 1:
            lines += [
                f"the largest {kind} within a window is {self.motion[kind]:.2g}; expected at least {least:g}"
                for kind, least in MIN_MOTION.items()
                if self.motion[kind] < least
            ]
            lines += [
                f"no {reason} resets the history" for reason in get_args(ResetKind) if not self.resets.get(reason)
            ]
            if not self.dropped_frames:
                lines.append("no frame follows a dropped frame")
        if self.calibrations < 2:
            lines.append("the calibration does not change")
        return [f"coverage: {line}" for line in lines]


def _lost_in_slot(frames: Sequence[Frame], windows: Sequence[Sequence[int]], slot: int) -> set[str]:
    """The cameras that are lost in at least one frame that is in `slot` of a window."""
    in_slot = [frames[window[slot]] for window in windows if len(window) > slot]
    return {name for frame in in_slot for name, image in frame.images.items() if image is None}


def _largest_motion(pairs: Sequence[tuple[Frame, Frame]]) -> dict[str, float]:
    """The largest motion of each kind between the frames (now, past) of any pair; 0 without pairs."""
    largest = dict.fromkeys(MIN_MOTION, 0.0)
    for now, past in pairs:
        past_T_now = inverse(nearest_rigid(past.global_T_ego)) @ nearest_rigid(now.global_T_ego)
        for kind, value in _motion(past_T_now).items():
            largest[kind] = max(largest[kind], abs(value))
    return largest


def _motion(past_T_now: NDArray[np.float64]) -> dict[str, float]:
    rotation, translation = past_T_now[:3, :3], past_T_now[:3, 3]
    return {
        "pitch_deg": float(np.degrees(np.arcsin(-rotation[2, 0]))),
        "roll_deg": float(np.degrees(np.arctan2(rotation[2, 1], rotation[2, 2]))),
        "yaw_deg": float(np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))),
        "height_m": float(translation[2]),
        "distance_m": float(np.linalg.norm(translation)),
    }


def _calibration(frame: Frame) -> bytes:
    parts = (array for camera in frame.cameras.values() for array in (camera.intrinsics_px, camera.camera_T_ego))
    return b"".join(np.ascontiguousarray(array, np.float64).tobytes() for array in parts)
