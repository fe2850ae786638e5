"""Training clips of the synthetic world. Each clip has its own drive, so they never end."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, count, islice

import numpy as np

from ...data.box_selection import known_ground_truth
from ...runtime.frame import Frame, GroundTruth
from ...synthetic.drive import FIRST_TRAINING_SEED, WORLD_VERSION, SyntheticDrive
from .clips import MAX_CLIPS
from .past_frames import PastFrames

ANCHOR_FRAMES = 144  # frames of synthetic clips from which the anchors are clustered


@dataclass(frozen=True)
class SyntheticClips:
    """One clip per drive: all of its frames. Each drive has its own seed, which no `synthetic:SEED` source can have.

    seed: the seed of the training run.
    num_frames: frames per drive.
    grid: cells (X, Y) of the ground-truth maps.
    """

    seed: int
    num_frames: int
    grid: tuple[int, int]

    @property
    def identity(self) -> str:
        return f"synthetic world {WORLD_VERSION}, clips of {self.num_frames} frames from seed {self._first_seed}"

    @property
    def samples_per_epoch(self) -> None:
        return None

    def frames(self, number: int) -> list[Frame]:
        return list(self.drive(number))

    def num_steps(self, number: int) -> int:
        return self.num_frames

    def ground_truth(self) -> Iterator[GroundTruth]:
        """The ground truth of the first ANCHOR_FRAMES frames."""
        drives = map(self.drive, count())
        known = chain.from_iterable(known_ground_truth(drive, range(len(drive))) for drive in drives)
        return islice(known, ANCHOR_FRAMES)

    def drive(self, number: int) -> SyntheticDrive:
        """The drive of clip `number`."""
        return SyntheticDrive(self._first_seed + number, self.num_frames, grid=self.grid)

    @property
    def _first_seed(self) -> int:
        return FIRST_TRAINING_SEED + self.seed * MAX_CLIPS


@dataclass(frozen=True)
class SyntheticWindows:
    """One sample per drive: a random frame of it, with its past frames. Only the newest frame is trained.

    A frame at the start of a drive has fewer past frames.

    drives: the drives, which are those of the clips with the same numbers.
    past: which past frames a sample has.
    """

    drives: SyntheticClips
    past: PastFrames

    @property
    def identity(self) -> str:
        return f"{self.drives.identity}, one sample per clip"

    @property
    def samples_per_epoch(self) -> None:
        return None

    def frames(self, number: int) -> list[Frame]:
        newest = int(np.random.default_rng([self.drives.seed, number]).integers(self.drives.num_frames))
        drive = self.drives.drive(number)
        return [drive.frame(index) for index in self.past.window(newest, 0, number)]

    def num_steps(self, number: int) -> int:
        return 1

    def ground_truth(self) -> Iterator[GroundTruth]:
        """The ground truth of the same frames as for `SyntheticClips`."""
        return self.drives.ground_truth()
