"""The temporal memory of one stream: what past frames left behind, when it breaks, and where the past was."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .bundle.manifest import Manifest, TemporalWindow, slot_name
from .errors import InputError
from .frame import Frame
from .geometry import inverse, nearest_rigid, rotation_angle
from .preprocessing import NetworkInputs
from .session import Tensors, tensors


@dataclass(frozen=True)
class PastFrame:
    """One frame that has been through the backbone and the lifter, and what it left in memory, by name.

    image_T_ego (N, 3, 4) and camera_valid (N) are as the graphs saw them.
    """

    scene: str
    timestamp_s: float
    global_T_ego: NDArray[np.float64]
    image_T_ego: NDArray[np.float32]
    camera_valid: NDArray[np.bool_]
    memory: Tensors

    @classmethod
    def of(cls, frame: Frame, inputs: NetworkInputs, memory: Tensors) -> "PastFrame":
        """The moment of a frame; its pose, here made exactly rigid, is a copy, so that the caller may write on his."""
        pose = nearest_rigid(np.asarray(frame.global_T_ego, dtype=np.float64))
        calibration = inputs.image_T_ego, inputs.camera_valid
        return cls(frame.scene, float(frame.timestamp_s), pose, *calibration, memory)


class History:
    """The past moments of a stream, newest first: as many as a window takes beside the current frame, and at least
    one, to know what is older. Immutable: `after` gives the next.
    """

    def __init__(self, manifest: Manifest, past: tuple[PastFrame, ...] = ()) -> None:
        self._manifest = manifest
        self._past = past

    def reset_reason(self, frame: Frame) -> str | None:
        """Why `frame` cannot continue this history, or None where it can.

        Raises InputError for a duplicate or older time stamp in the same scene.
        """
        return reset_reason(self._past[0], frame, self._manifest.window) if self._past else None

    def after(self, now: PastFrame) -> "History":
        """The history once `now` is past."""
        return History(self._manifest, (now, *self._past)[: max(1, self._manifest.window.num_frames - 1)])

    def window(self, now: PastFrame, nothing: Tensors) -> tuple[Tensors, int]:
        """The decoder's inputs at `now`, and how many frames they hold; `nothing` stands in empty slots.

        What the frames left in memory is bound as it lies; only poses and flags are written. Poses and times are
        float64 until they are differences.
        """
        size = self._manifest.window.num_frames
        moments = (now, *self._past)[:size]
        past_T_now = np.tile(np.eye(4, dtype=np.float32), (size, 1, 1))
        time_delta_s, frame_valid = np.zeros(size, np.float32), np.zeros(size, np.bool_)
        projections = np.zeros((size, *now.image_T_ego.shape), np.float32)
        camera_valid = np.zeros((size, *now.camera_valid.shape), np.bool_)
        for t, moment in enumerate(moments):
            if t > 0:  # now is where it is, exactly; rounding would move every box with the place on Earth
                past_T_now[t] = inverse(moment.global_T_ego) @ now.global_T_ego
                time_delta_s[t] = now.timestamp_s - moment.timestamp_s
            projections[t], camera_valid[t], frame_valid[t] = moment.image_T_ego, moment.camera_valid, True
        bound = tensors(
            image_T_ego=projections,
            past_T_now=past_T_now,
            time_delta_s=time_delta_s,
            frame_valid=frame_valid,
            camera_valid=camera_valid,
        )
        for t in range(size):
            memory = moments[t].memory if t < len(moments) else nothing
            bound |= {slot_name(t, name): memory[name] for name in self._manifest.memory}
        return bound, len(moments)


def reset_reason(last: PastFrame | Frame, frame: Frame, limits: TemporalWindow) -> str | None:
    """Why `frame` does not continue the drive that `last` was the newest moment of, or None where it does.

    Raises InputError for a duplicate or older time stamp in the same scene.
    """
    if frame.scene != last.scene:
        return f"new scene {frame.scene!r} after {last.scene!r}"
    delta_s = float(frame.timestamp_s) - last.timestamp_s
    if delta_s <= 0:
        raise InputError(
            f"timestamp_s: expected later than {last.timestamp_s!r} of the frame before; got "
            f"{frame.timestamp_s!r}. Leave the frame out, or reset the stream."
        )
    if delta_s > limits.largest_time_delta_s:
        return f"gap of {delta_s:.2f} s, above {limits.largest_time_delta_s:g} s"
    jump_m = float(np.linalg.norm(frame.global_T_ego[:3, 3] - last.global_T_ego[:3, 3]))
    if jump_m > limits.largest_speed_m_s * delta_s:
        return f"ego jump of {jump_m:.1f} m in {delta_s:.2f} s"
    turn_rad = rotation_angle(last.global_T_ego[:3, :3].T @ frame.global_T_ego[:3, :3])
    if turn_rad > limits.largest_turn_rad_s * delta_s:
        return f"ego turn of {np.degrees(turn_rad):.0f} degrees in {delta_s:.2f} s"
    return None
