"""What is trained on: drives of a few frames each, drawn or cut from a source; the next ones are made meanwhile."""

import io
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, count, islice, pairwise
from multiprocessing import resource_tracker
from typing import Protocol

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import DataLoader, Dataset

from ..data.anchor_clustering import ground_truth_centres
from ..data.source import Source
from ..model import DuoSpaceNetConfig
from ..runtime.bundle.manifest import Preprocessing, TemporalWindow
from ..runtime.errors import DuoSpaceNetError
from ..runtime.frame import Frame
from ..runtime.history import reset_reason
from ..synthetic.drive import FIRST_TRAINING_SEED, WORLD_VERSION, SyntheticDrive
from .settings import Settings
from .training_frames import Sample, make_sample

WORKERS_NICENESS = 10  # training must not wait for a core, and drawing is ahead of it
MOST_DRIVES = 10**9  # of one training; the next seed's begin behind them
ANCHOR_FRAMES = 144  # of drives without end, in whose objects anchors are sought

Drive = list[Sample]


class Drives(Protocol):
    """Drives by number, without end; a number always means the same drive."""

    @property
    def identity(self) -> str:
        """Words for what the frames are."""

    def frames(self, number: int) -> list[Frame]: ...

    def length(self, number: int) -> int:
        """How many frames drive `number` has, without the work to make them."""

    def ground_truth_centres(self) -> Iterator[NDArray[np.float64]]:
        """The centres (D, 3) of the true boxes, frame by frame, in which anchors are sought."""


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
        return list(self._drive(number))

    def length(self, number: int) -> int:
        return self.num_frames

    def ground_truth_centres(self) -> Iterator[NDArray[np.float64]]:
        """Of the first ANCHOR_FRAMES frames."""
        drives = map(self._drive, count())
        centres = chain.from_iterable(ground_truth_centres(drive, range(len(drive))) for drive in drives)
        return islice(centres, ANCHOR_FRAMES)

    def _drive(self, number: int) -> SyntheticDrive:
        return SyntheticDrive(self._first + number, self.num_frames, grid=self.grid)

    @property
    def _first(self) -> int:
        return FIRST_TRAINING_SEED + self.seed * MOST_DRIVES


@dataclass(frozen=True)
class CutDrives:
    """A source cut into drives, where a stream would drop its history and after `num_frames`; once through it, then
    again in another order. limits: when a stream drops its history.
    """

    source: Source
    seed: int
    num_frames: int
    limits: TemporalWindow

    @property
    def identity(self) -> str:
        limits = f"{self.limits.largest_time_delta_s:g} s, {self.limits.largest_speed_m_s:g} m/s"
        turn = f"{np.degrees(self.limits.largest_turn_rad_s):g} degrees/s"
        return f"{self.source.identity}, cut beyond {limits} or {turn}"

    def frames(self, number: int) -> list[Frame]:
        return [self.source.frame(index) for index in self._piece(number)]

    def length(self, number: int) -> int:
        return len(self._piece(number))

    def ground_truth_centres(self) -> Iterator[NDArray[np.float64]]:
        """Of all frames of the source."""
        return ground_truth_centres(self.source, range(len(self.source)))

    def _piece(self, number: int) -> range:
        """The indices of the frames of drive `number`."""
        epoch, place = divmod(number, len(self._pieces))
        generator = torch.Generator().manual_seed(self.seed * MOST_DRIVES + epoch)
        return self._pieces[int(torch.randperm(len(self._pieces), generator=generator)[place])]

    @cached_property
    def _pieces(self) -> list[range]:
        frames = map(self.source.frame_without_images, range(len(self.source)))
        cuts = (reset_reason(last, frame, self.limits) is not None for last, frame in pairwise(frames))
        starts = [0, *(index for index, cut in enumerate(cuts, 1) if cut)]
        return [
            range(first, min(first + self.num_frames, end))
            for start, end in pairwise([*starts, len(self.source)])
            for first in range(start, end, self.num_frames)
        ]


def next_drives(drives: Drives, settings: Settings, step: int) -> range:
    """The numbers of the drives that are to come when `step` steps are done, up to the training's end.

    Drives are driven side by side, so that each group of them takes as many steps as its longest has frames.
    """
    first = _groups_within(drives, settings, step)
    end = _groups_within(drives, settings, settings.steps)
    return range(first * settings.drives_per_step, end * settings.drives_per_step)


def _groups_within(drives: Drives, settings: Settings, steps: int) -> int:
    """How many groups of drives are begun in so many steps."""
    size, groups = settings.drives_per_step, 0
    while steps > 0:
        steps -= max(drives.length(number) for number in range(groups * size, (groups + 1) * size))
        groups += 1
    return groups


@dataclass(frozen=True)
class _Samples(Dataset[Drive | DuoSpaceNetError]):
    """Drives as samples. A failure is an item as well: what a worker raises, DataLoader retells with a traceback."""

    drives: Drives
    config: DuoSpaceNetConfig
    preprocessing: Preprocessing

    def __getitem__(self, number: int) -> Drive | DuoSpaceNetError:
        try:
            return [make_sample(frame, self.config, self.preprocessing) for frame in self.drives.frames(number)]
        except DuoSpaceNetError as error:
            return error


def load_drives(
    drives: Drives, config: DuoSpaceNetConfig, preprocessing: Preprocessing, numbers: range, workers: int
) -> Iterator[Drive]:
    """The drives of these numbers in order; `workers` processes make them ahead of time, or none.

    Raises InputError for frames that cannot be trained on.
    """
    loader = DataLoader(
        _Samples(drives, config, preprocessing),
        sampler=numbers,
        batch_size=None,
        num_workers=workers,
        prefetch_factor=4 if workers else None,
        worker_init_fn=_work_alone,
        # A fork would inherit OpenCV's threads, and wait for them.
        multiprocessing_context="spawn" if workers else None,
    )
    with _interruption_waits():
        items = iter(loader)
    try:
        for item in items:
            if isinstance(item, DuoSpaceNetError):
                raise item
            yield item
    finally:
        _end_of_workers_is_no_failure()


@contextmanager
def _interruption_waits() -> Iterator[None]:
    """Around the start of processes, which inherit that Ctrl-C does not reach them: they end with this one, and would
    each print a traceback. Here it is heard when the block has ended.
    """
    resource_tracker.ensure_running()  # multiprocessing's own process; its start lets interruptions through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_of_workers_is_no_failure() -> None:
    """DataLoader ends a worker that is slow to go, and its own handler then takes that for a crash."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)


def _work_alone(_: int) -> None:
    """What a worker has to say goes through its queue. multiprocessing's thread that hands over tensors would print a
    traceback where the training ends in the middle of it.
    """
    sys.stderr = io.StringIO()
    if hasattr(os, "nice"):
        os.nice(WORKERS_NICENESS)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
