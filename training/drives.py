"""What is trained on: drives of a few frames each, drawn or cut from a source; the next ones are made meanwhile."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import cv2
import torch
from torch.utils.data import DataLoader, Dataset

from ..model import DuoSpaceNetConfig
from ..runtime.frame import Frame
from ..runtime.manifest import Preprocessing
from ..runtime.sources import Source
from ..runtime.sources.synthetic import FIRST_TRAINING_SEED, WORLD_VERSION, SyntheticDrive
from .samples import Sample, make_sample

MOST_DRIVES = 10**9  # of one training; the next seed's begin behind them

Drive = list[Sample]


class Drives(Protocol):
    """Drives by number; a number always means the same drive."""

    @property
    def identity(self) -> str:
        """Words for what the frames are."""

    def frames(self, number: int) -> list[Frame]: ...


@dataclass(frozen=True)
class DrawnDrives:
    """Drives through the synthetic world, without end, each of a seed that `synthetic:` never shows."""

    seed: int
    num_frames: int
    grid: tuple[int, int]

    @property
    def identity(self) -> str:
        return f"synthetic world {WORLD_VERSION}, drives of {self.num_frames} frames from seed {self._first}"

    def frames(self, number: int) -> list[Frame]:
        return list(SyntheticDrive(self._first + number, self.num_frames, grid=self.grid))

    @property
    def _first(self) -> int:
        return FIRST_TRAINING_SEED + self.seed * MOST_DRIVES


@dataclass(frozen=True)
class CutDrives:
    """A source cut into drives of one scene each; once through it, then again in another order."""

    source: Source
    seed: int
    num_frames: int

    @property
    def identity(self) -> str:
        return self.source.identity

    def frames(self, number: int) -> list[Frame]:
        epoch, place = divmod(number, len(self._pieces))
        generator = torch.Generator().manual_seed(self.seed * MOST_DRIVES + epoch)
        piece = int(torch.randperm(len(self._pieces), generator=generator)[place])
        return [self.source.frame(index) for index in self._pieces[piece]]

    @cached_property
    def _pieces(self) -> list[range]:
        scenes = [frame.scene for frame in self.source]
        starts = [i for i, scene in enumerate(scenes) if i == 0 or scene != scenes[i - 1]]
        return [
            range(first, min(first + self.num_frames, end))
            for start, end in zip(starts, [*starts[1:], len(scenes)], strict=True)
            for first in range(start, end, self.num_frames)
        ]


@dataclass(frozen=True)
class _Samples(Dataset[Drive]):
    drives: Drives
    config: DuoSpaceNetConfig
    preprocessing: Preprocessing

    def __getitem__(self, number: int) -> Drive:
        return [make_sample(frame, self.config, self.preprocessing) for frame in self.drives.frames(number)]


def load_drives(
    drives: Drives, config: DuoSpaceNetConfig, preprocessing: Preprocessing, numbers: range, workers: int
) -> Iterator[Drive]:
    """The drives of these numbers in order; `workers` processes make them ahead of time, or none."""
    yield from DataLoader(
        _Samples(drives, config, preprocessing),
        sampler=numbers,
        batch_size=None,
        num_workers=workers,
        prefetch_factor=4 if workers else None,
        worker_init_fn=_work_alone,
        multiprocessing_context="spawn"
        if workers
        else None,  # a fork would inherit OpenCV's threads, and wait for them
    )


def _work_alone(_: int) -> None:
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
