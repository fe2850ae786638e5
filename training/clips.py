"""Training clips: short runs of consecutive frames, either synthetic or taken from a source."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count, islice, pairwise
from typing import Protocol

import numpy as np
import torch

from ..data.box_selection import known_ground_truth
from ..data.source import Source
from ..runtime.bundle.temporal_window import TemporalWindow
from ..runtime.frame import Frame, GroundTruth
from ..runtime.history import find_reset
from ..synthetic.drive import FIRST_TRAINING_SEED, WORLD_VERSION, SyntheticDrive

MAX_CLIPS = 10**9  # of a training run; the clips of the next training seed start after them
ANCHOR_FRAMES = 144  # frames of synthetic clips from which the anchors are clustered


class Clips(Protocol):
    """An endless, numbered sequence of clips. A number always gives the same clip."""

    @property
    def identity(self) -> str:
        """A description of the frames. Two sequences with the same description have the same frames."""

    def frames(self, number: int) -> list[Frame]:
        """The frames of clip `number`, in time order."""

    def length(self, number: int) -> int:
        """The number of frames of clip `number`. Renders and reads no images."""

    def ground_truth(self) -> Iterator[GroundTruth]:
        """The ground truth of the frames that anchors are clustered from, without maps."""


@dataclass(frozen=True)
class SyntheticClips:
    """Clips of the synthetic world. Each clip has its own seed, which no `synthetic:SEED` source can have.

    seed: the seed of the training run.
    num_frames: frames per clip.
    grid: cells (X, Y) of the ground-truth maps.
    """

    seed: int
    num_frames: int
    grid: tuple[int, int]

    @property
    def identity(self) -> str:
        return f"synthetic world {WORLD_VERSION}, clips of {self.num_frames} frames from seed {self._first_seed}"

    def frames(self, number: int) -> list[Frame]:
        return list(self._drive(number))

    def length(self, number: int) -> int:
        return self.num_frames

    def ground_truth(self) -> Iterator[GroundTruth]:
        """The ground truth of the first ANCHOR_FRAMES frames."""
        drives = map(self._drive, count())
        known = chain.from_iterable(known_ground_truth(drive, range(len(drive))) for drive in drives)
        return islice(known, ANCHOR_FRAMES)

    def _drive(self, number: int) -> SyntheticDrive:
        return SyntheticDrive(self._first_seed + number, self.num_frames, grid=self.grid)

    @property
    def _first_seed(self) -> int:
        return FIRST_TRAINING_SEED + self.seed * MAX_CLIPS


@dataclass(frozen=True)
class SourceClips:
    """Clips of a source. Each epoch contains every frame once. The random order of its clips differs between epochs.

    The source is split where the runtime would reset the history, and after every `num_frames` frames.

    source: a source with ground truth.
    seed: the seed of the random order.
    num_frames: frames per clip; a clip before a reset may be shorter.
    limits: the limits beyond which the runtime resets the history.
    """

    source: Source
    seed: int
    num_frames: int
    limits: TemporalWindow

    @property
    def identity(self) -> str:
        limits = f"{self.limits.largest_time_delta_s:g} s, {self.limits.largest_speed_m_s:g} m/s"
        turn = f"{np.degrees(self.limits.largest_turn_rad_s):g} degrees/s"
        return f"{self.source.identity}, split beyond {limits} or {turn}"

    def frames(self, number: int) -> list[Frame]:
        return [self.source.frame(index) for index in self._indices(number)]

    def length(self, number: int) -> int:
        return len(self._indices(number))

    def ground_truth(self) -> Iterator[GroundTruth]:
        """The ground truth of all frames of the source."""
        return known_ground_truth(self.source, range(len(self.source)))

    def _indices(self, number: int) -> range:
        """The indices of the frames of clip `number` in the source."""
        epoch, position = divmod(number, len(self._ranges))
        generator = torch.Generator().manual_seed(self.seed * MAX_CLIPS + epoch)
        return self._ranges[int(torch.randperm(len(self._ranges), generator=generator)[position])]

    @cached_property
    def _ranges(self) -> list[range]:
        """The frame indices of each clip, in the order of the source."""
        frames = map(self.source.frame_without_images, range(len(self.source)))
        is_reset = (find_reset(last, frame, self.limits) is not None for last, frame in pairwise(frames))
        starts = [0, *(index for index, reset in enumerate(is_reset, 1) if reset)]
        return [
            range(first, min(first + self.num_frames, end))
            for start, end in pairwise([*starts, len(self.source)])
            for first in range(start, end, self.num_frames)
        ]
