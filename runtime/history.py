"""The temporal history of one stream: cached values of past frames, reset rules and relative poses."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from .bundle.manifest import Manifest, slot_name
from .errors import InputError
from .frame import Frame
from .geometry import inverse, nearest_rigid, rotation_angle
from .preprocessing import NetworkInputs
from .session import Tensors, to_tensors
from .window_selection import WindowSelection

ResetKind = Literal["new scene", "gap", "ego jump", "ego turn"]


class ResetReason(NamedTuple):
    """Why a history cannot be continued. text: with the numbers, for a report."""

    kind: ResetKind
    text: str


class ResetLimits(Protocol):
    """The limits beyond which the history is reset, for example those of the manifest's temporal window."""

    @property
    def largest_time_delta_s(self) -> float: ...

    @property
    def largest_speed_m_s(self) -> float: ...

    @property
    def largest_turn_rad_s(self) -> float: ...


@dataclass(frozen=True)
class PastFrame:
    """A processed frame, with the values that later frames need.

    scene, timestamp_s [s]: copied from the frame.
    global_T_ego: (4, 4) float64, the ego pose, made exactly rigid.
    image_T_ego: (N, 3, 4) float32, the projections to the network's images [px].
    camera_valid: (N,) bool, False for lost cameras.
    memory: cached graph outputs by name; the names are those of the manifest's `memory`.
    """

    scene: str
    timestamp_s: float
    global_T_ego: NDArray[np.float64]
    image_T_ego: NDArray[np.float32]
    camera_valid: NDArray[np.bool_]
    memory: Tensors

    @classmethod
    def of(cls, frame: Frame, inputs: NetworkInputs, memory: Tensors) -> "PastFrame":
        """Build the record of a frame. The pose is copied, so that the frame's array may be changed afterwards."""
        pose = nearest_rigid(np.asarray(frame.global_T_ego, dtype=np.float64))
        calibration = inputs.image_T_ego, inputs.camera_valid
        return cls(frame.scene, float(frame.timestamp_s), pose, *calibration, memory)


class History:
    """The past frames of a stream, newest first. Immutable: `after` returns the next history.

    It contains the frames that later windows may need: by default at most `num_frames - 1` of the manifest's window.
    It always contains the newest frame, because its time stamp is needed to refuse older frames.
    """

    def __init__(self, manifest: Manifest, past: tuple[PastFrame, ...] = (), step_s: float | None = None) -> None:
        """step_s: the time between two frames of the window [s], see `WindowSelection`; None for the newest frames.

        Raises UsageError for a step that is not valid.
        """
        self._manifest = manifest
        self._past = past
        window = manifest.window
        self.selection = WindowSelection(window.num_frames - 1, step_s, window.largest_time_delta_s)

    def __len__(self) -> int:
        """The number of past frames whose cached values are in memory."""
        return len(self._past)

    def cleared(self) -> "History":
        """Return an empty history with the same step."""
        return History(self._manifest, (), self.selection.step_s)

    def reset_reason(self, frame: Frame) -> str | None:
        """Return why `frame` cannot continue this history, or None if it can.

        Raises InputError for a duplicate or older time stamp in the same scene.
        """
        reason = find_reset(self._past[0], frame, self._manifest.window) if self._past else None
        return reason.text if reason else None

    def after(self, now: PastFrame) -> "History":
        """Return the history with `now` as its newest frame; frames that no later window needs are removed."""
        past = now, *self._past
        num_needed = self.selection.num_needed(_ages_s(now, past))
        return History(self._manifest, past[:num_needed], self.selection.step_s)

    def window(self, now: PastFrame) -> list[PastFrame]:
        """Return the frames of the temporal window of the frame `now`, which is the first; then newest first."""
        return [now, *(self._past[index] for index in self.selection.select(_ages_s(now, self._past)))]

    def decoder_inputs(self, now: PastFrame, empty_memory: Tensors) -> tuple[Tensors, tuple[float, ...]]:
        """Build the decoder's inputs for the frame `now`. Slot t of T has the t-th frame of the window before `now`.

        empty_memory: cached values for slots without a frame; the decoder masks them.

        Returns the tensors by name, and the ages [s] of the past frames in the window. Cached values are passed on
        without a copy. The other tensors are image_T_ego (T, N, 3, 4), past_T_now (T, 4, 4), time_delta_s (T,) [s],
        frame_valid (T,) and camera_valid (T, N).
        """
        # Poses and times stay float64 until they are differences: near 5e6 m, float32 numbers are 0.5 m apart.
        size = self._manifest.window.num_frames
        window = self.window(now)
        past_T_now = np.tile(np.eye(4, dtype=np.float32), (size, 1, 1))
        time_delta_s, frame_valid = np.zeros(size, np.float32), np.zeros(size, np.bool_)
        projections = np.zeros((size, *now.image_T_ego.shape), np.float32)
        camera_valid = np.zeros((size, *now.camera_valid.shape), np.bool_)
        for t, past in enumerate(window):
            if t > 0:  # the current frame keeps the exact identity; a computed one has rounding errors of the pose
                past_T_now[t] = inverse(past.global_T_ego) @ now.global_T_ego
                time_delta_s[t] = now.timestamp_s - past.timestamp_s
            projections[t], camera_valid[t], frame_valid[t] = past.image_T_ego, past.camera_valid, True
        decoder_inputs = to_tensors(
            image_T_ego=projections,
            past_T_now=past_T_now,
            time_delta_s=time_delta_s,
            frame_valid=frame_valid,
            camera_valid=camera_valid,
        )
        for t in range(size):
            memory = window[t].memory if t < len(window) else empty_memory
            decoder_inputs |= {slot_name(t, name): memory[name] for name in self._manifest.memory}
        return decoder_inputs, _ages_s(now, window[1:])


def find_reset(last: PastFrame | Frame, frame: Frame, limits: ResetLimits) -> ResetReason | None:
    """Return why `frame` cannot continue a history that ends with the frame `last`, or None if it can.

    Reasons are a new scene, a time gap, and an ego jump or turn that no vehicle can make, by `limits`.
    Raises InputError for a duplicate or older time stamp in the same scene.
    """
    if frame.scene != last.scene:
        return ResetReason("new scene", f"new scene {frame.scene!r} after {last.scene!r}")
    delta_s = float(frame.timestamp_s) - last.timestamp_s
    if delta_s <= 0:
        raise InputError(
            f"timestamp_s: expected later than {last.timestamp_s!r} of the frame before; got "
            f"{frame.timestamp_s!r}. Leave the frame out, or reset the stream."
        )
    if delta_s > limits.largest_time_delta_s:
        return ResetReason("gap", f"gap of {delta_s:.2f} s, above {limits.largest_time_delta_s:g} s")
    jump_m = float(np.linalg.norm(frame.global_T_ego[:3, 3] - last.global_T_ego[:3, 3]))
    if jump_m > limits.largest_speed_m_s * delta_s:
        return ResetReason("ego jump", f"ego jump of {jump_m:.1f} m in {delta_s:.2f} s")
    # As in the decoder's inputs, rounding errors of the poses are removed first: they would enlarge the angle.
    old, new = (nearest_rigid(np.asarray(pose, np.float64)) for pose in (last.global_T_ego, frame.global_T_ego))
    turn_rad = rotation_angle(old[:3, :3].T @ new[:3, :3])
    if turn_rad > limits.largest_turn_rad_s * delta_s:
        return ResetReason("ego turn", f"ego turn of {np.degrees(turn_rad):.0f} degrees in {delta_s:.2f} s")
    return None


def _ages_s(now: PastFrame, past: Sequence[PastFrame]) -> tuple[float, ...]:
    """The ages [s] of past frames at the time of the frame `now`."""
    return tuple(now.timestamp_s - frame.timestamp_s for frame in past)
