"""The temporal window: the ego motion, time and calibration of its frames, and the temporal queries."""

from typing import NamedTuple

from torch import Tensor


class Window(NamedTuple):
    """The frames of the temporal window. Index 0 is the current frame, index t is t frames ago.

    image_T_ego (T, N, 3, 4) [px]: the calibration of each frame, from the ego frame of that frame.
    past_T_now (T, 4, 4): from the current ego frame to the ego frame of each frame [m].
    time_delta_s (T): the age of each frame [s].
    frame_valid (T) bool: False for an empty slot, of which all other values are ignored. Slot 0 is always valid.
    camera_valid (T, N) bool: False for a lost camera.
    """

    image_T_ego: Tensor
    past_T_now: Tensor
    time_delta_s: Tensor
    frame_valid: Tensor
    camera_valid: Tensor

    def newest(self, num_frames: int) -> "Window":
        """The window with only the newest frames."""
        return Window(*(field[:num_frames] for field in self))


class TemporalQueries(NamedTuple):
    """The poses of the queries in every frame of the window. The content of a query is the same in all frames.

    poses (T, Q, 10): pose vectors in the ego frame of each frame.
    embeddings (T, Q, C): their embeddings Q_Pose.
    """

    poses: Tensor
    embeddings: Tensor

    def newest(self, num_frames: int) -> "TemporalQueries":
        """The temporal queries of only the newest frames."""
        return TemporalQueries(self.poses[:num_frames], self.embeddings[:num_frames])

    def halves(self) -> tuple["TemporalQueries", "TemporalQueries"]:
        """The first and the second half of the queries."""
        poses, embeddings = self.poses.chunk(2, dim=1), self.embeddings.chunk(2, dim=1)
        return TemporalQueries(poses[0], embeddings[0]), TemporalQueries(poses[1], embeddings[1])
