"""A clip of a batch as the samples that are trained on, one per step."""

from collections.abc import Sequence
from typing import NamedTuple

import torch

from .encoded_frames import EncodedFrame
from .samples.training_frames import Clip, TrainingFrame
from .settings import Settings


class Sample(NamedTuple):
    """A frame to train on.

    frame: the newest frame, on the device of the model.
    past: its past frames on the same device, the newest first. Frames without features are encoded.
    clip: the number of its clip in the batch of all processes, for the random numbers.
    weight: the weight of its detection losses.
    """

    frame: TrainingFrame
    past: Sequence[EncodedFrame | TrainingFrame]
    clip: int
    weight: float = 1.0


class SampledClip:
    """A clip, with the history of the frames that were trained.

    With the history "stream", every frame is a sample, and its past frames keep the features of the steps that trained
    them. With "windows", the newest frame is the only sample, and its past frames have no features yet.

    clip: the frames. number: the number of the clip in the batch of all processes.
    num_past_frames: the largest number of past frames of a sample.
    """

    def __init__(self, clip: Clip, number: int, settings: Settings, num_past_frames: int) -> None:
        self.clip = clip
        self.number = number
        self.is_stream = settings.history == "stream"
        self.num_past_frames = num_past_frames
        self._history: list[EncodedFrame] = []

    @property
    def num_samples(self) -> int:
        """The number of samples, each for one step."""
        return len(self.clip) if self.is_stream else 1

    def newest(self, index: int) -> TrainingFrame:
        """The newest frame of sample `index`."""
        return self.clip[index] if self.is_stream else self.clip[-1]

    def sample(self, index: int, weight: float, device: torch.device) -> Sample:
        """Sample `index` on a device. The samples before it must have been trained, and passed to `remember`."""
        frame = self.newest(index).to(device)
        if self.is_stream:
            return Sample(frame, self._history, self.number, weight)
        past = [past.to(device) for past in reversed(self.clip[:-1])]
        return Sample(frame, past[: self.num_past_frames], self.number, weight)

    def remember(self, trained: EncodedFrame) -> None:
        """Add the newest frame of a sample to the history, with features that need no gradient."""
        self._history = [trained, *self._history][: self.num_past_frames]
