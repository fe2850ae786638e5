"""The protocol of training clips: an endless, numbered sequence of short runs of frames."""

from collections.abc import Iterator
from typing import Protocol

from ...runtime.frame import Frame, GroundTruth

MAX_CLIPS = 10**9  # of a training run; the clips of the next training seed start after them


class Clips(Protocol):
    """An endless, numbered sequence of clips. A number always gives the same clip."""

    @property
    def identity(self) -> str:
        """A description of the frames. Two sequences with the same description have the same frames."""

    @property
    def samples_per_epoch(self) -> int | None:
        """The number of trained frames in the first pass over the frames; None without end."""

    def frames(self, number: int) -> list[Frame]:
        """The frames of clip `number`, in time order. Renders and reads no other images."""

    def num_steps(self, number: int) -> int:
        """The number of frames of clip `number` that are trained, one per step: its newest. Reads no images."""

    def ground_truth(self) -> Iterator[GroundTruth]:
        """The ground truth of the frames that anchors are clustered from, without maps."""
