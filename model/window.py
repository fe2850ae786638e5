"""The temporal window: where and when its frames were, and the queries as they were then."""

from typing import NamedTuple

from torch import Tensor


class Window(NamedTuple):
    """The frames of the temporal window. Index 0 is now and always there, index t is t frames ago.

    image_T_ego (T, N, 3, 4) [px]: each frame's own calibration, from its own ego frame.
    past_T_now (T, 4, 4): from the current ego frame to that frame's. time_delta_s (T): how long ago.
    frame_valid (T) bool: a slot that holds no frame changes nothing, whatever lies in it.
    camera_valid (T, N) bool: False for a lost camera.
    """

    image_T_ego: Tensor
    past_T_now: Tensor
    time_delta_s: Tensor
    frame_valid: Tensor
    camera_valid: Tensor

    def newest(self, num_frames: int) -> "Window":
        """The window of the newest frames alone."""
        return Window(*(field[:num_frames] for field in self))


class TemporalQueries(NamedTuple):
    """What the queries of all moments differ in: poses (T, Q, 10), each in its frame's ego frame, and their embeddings
    Q_Pose (T, Q, C). The content is that of now.
    """

    poses: Tensor
    embeddings: Tensor

    def newest(self, num_frames: int) -> "TemporalQueries":
        """Those of the newest frames."""
        return TemporalQueries(self.poses[:num_frames], self.embeddings[:num_frames])

    def halves(self) -> tuple["TemporalQueries", "TemporalQueries"]:
        """The first and the second half of the queries."""
        poses, embeddings = self.poses.chunk(2, dim=1), self.embeddings.chunk(2, dim=1)
        return TemporalQueries(poses[0], embeddings[0]), TemporalQueries(poses[1], embeddings[1])
