"""The temporal window that each frame of a sequence must have, for the reference of the parity check."""

from collections.abc import Sequence

import numpy as np

from ...runtime import Frame
from ...runtime.bundle.temporal_window import TemporalWindow
from ...runtime.history import ResetKind


def expected_windows(frames: Sequence[Frame], limits: TemporalWindow) -> list[list[int]]:
    """For each frame, the indices of the frames in its window, newest first.

    The window of a frame with every camera lost is empty: the pipeline skips such a frame.

    limits: the number of frames in a window, and the limits beyond which the history is reset.

    This is a second implementation of the reset rules. It shares no code with the pipeline's history, so the parity
    check detects an error in either one.
    """
    windows: list[list[int]] = []
    newest: list[int] = []  # the window of the last frame that was not skipped
    for index, frame in enumerate(frames):
        if is_skipped(frame):
            windows.append([])
            continue
        continues = bool(newest) and reset_kind(frames[newest[0]], frame, limits) is None
        newest = [index, *(newest[: limits.num_frames - 1] if continues else [])]
        windows.append(newest)
    return windows


def is_skipped(frame: Frame) -> bool:
    """Whether every camera of the frame is lost."""
    return bool(frame.images) and all(image is None for image in frame.images.values())


def reset_kind(previous: Frame, now: Frame, limits: TemporalWindow) -> ResetKind | None:
    """The kind of the reset between two frames that are not skipped, or None if the history continues."""
    elapsed_s = now.timestamp_s - previous.timestamp_s
    moved_m = np.linalg.norm(now.global_T_ego[:3, 3] - previous.global_T_ego[:3, 3])
    rotation = previous.global_T_ego[:3, :3].T @ now.global_T_ego[:3, :3]
    # The rotation angle: its sine from the antisymmetric part, its cosine from the trace.
    turned_rad = np.arctan2(np.linalg.norm(rotation - rotation.T) / np.sqrt(8), (np.trace(rotation) - 1) / 2)
    if now.scene != previous.scene:
        return "new scene"
    # `not <=` instead of `>`, so that a NaN resets the history.
    if not elapsed_s <= limits.largest_time_delta_s:
        return "gap"
    if not moved_m <= limits.largest_speed_m_s * elapsed_s:
        return "ego jump"
    return None if turned_rad <= limits.largest_turn_rad_s * elapsed_s else "ego turn"
