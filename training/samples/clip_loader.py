"""Loading clips as tensors, in this process or ahead of time in worker processes."""

import io
import os
import resource
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker

import cv2
import torch
from torch.utils.data import DataLoader, Dataset

from ...model import DuoSpaceNetConfig
from ...runtime.bundle.preprocessing_record import Preprocessing
from ...runtime.errors import DuoSpaceNetError
from ...runtime.process_errors import LostProcessError
from ..settings import Settings
from ..tasks import NO_TASKS, trained_tasks
from .augmentation import sample_augmentation
from .clips import Clips
from .training_frames import Clip, make_training_frame

PREFETCH_FACTOR = 4  # clips that each worker prepares ahead of time
DEFAULT_SETTINGS = Settings()
WORKER_NICENESS = 10  # workers run ahead, so they yield the cores to the training process


def load_clips(
    clips: Clips,
    config: DuoSpaceNetConfig,
    preprocessing: Preprocessing,
    numbers: Sequence[int],
    workers: int,
    settings: Settings = DEFAULT_SETTINGS,
    pin_memory: bool = False,
) -> Iterator[Clip]:
    """Load the clips with these numbers, in order.

    clips: the sequence to load from.
    config: the configuration of the model that is trained.
    preprocessing: the preprocessing of camera images for this model.
    numbers: the numbers of the clips, from `remaining_clips` and `clips_of_process`.
    workers: number of processes that prepare clips ahead of time; 0 prepares them in this process.
    settings: the tasks and the augmentation.
    pin_memory: put the tensors into page-locked memory, from which a GPU copies without waiting for the CPU.

    Raises InputError for a frame that cannot be trained on, with the same message for any number of workers. Raises
    LostProcessError if a worker was killed.
    """
    if workers:
        _allow_many_open_files()
    loader = DataLoader(
        _ClipDataset(clips, config, preprocessing, settings),
        sampler=numbers,
        batch_size=None,
        num_workers=workers,
        prefetch_factor=PREFETCH_FACTOR if workers else None,
        worker_init_fn=_initialise_worker,
        # "fork" would copy the locks of OpenCV's threads without the threads, and the workers would deadlock.
        multiprocessing_context="spawn" if workers else None,
        pin_memory=pin_memory,
    )
    with _interrupts_blocked():
        items = iter(loader)
    try:
        with lost_workers_reported(receiving=workers > 0):
            for item in items:
                if isinstance(item, DuoSpaceNetError):
                    raise item
                yield item
    finally:
        _remove_worker_exit_handler()


@contextmanager
def lost_workers_reported(receiving: bool = False) -> Iterator[None]:
    """Raise LostProcessError if a worker is killed during the block.

    DataLoader notices this in a signal handler, so the error may come up anywhere: not only while clips are loaded.

    receiving: whether tensors are received from workers in the block. The connection to a killed worker is broken.
    """
    try:
        yield
    except (RuntimeError, ConnectionError, FileNotFoundError, EOFError) as error:
        is_broken = receiving and not isinstance(error, RuntimeError) and not _is_from_worker(error)
        if not is_broken and "DataLoader worker (pid" not in str(error):
            raise
        raise LostProcessError(
            "--workers: expected the next clip from a worker process; got none. It was killed, probably because the "
            "memory or the shared memory (/dev/shm) is full. Use fewer --workers, and --resume to continue from the "
            "last checkpoint."
        ) from error


def _is_from_worker(error: Exception) -> bool:
    """Whether an error was raised in a worker, by code that loads clips, and passed on by DataLoader."""
    return str(error).startswith("Caught ")


def remaining_clips(clips: Clips, settings: Settings, step: int, restarts: Sequence[int] = ()) -> range:
    """The numbers of the clips that a training run still needs after `step` completed steps.

    A batch of clips takes as many steps as its longest clip has trained frames. `step` must be at the end of a batch.

    restarts: completed steps, in order, after which the training was extended. A new batch begins there, even if the
        last one was not finished.
    """
    first = _num_batches(clips, settings, step, restarts)
    end = _num_batches(clips, settings, settings.steps, restarts)
    return range(first * settings.batch_size, end * settings.batch_size)


def clips_of_process(numbers: range, settings: Settings, rank: int, num_processes: int) -> Sequence[int]:
    """The numbers of the clips that one of several processes trains: an equal, contiguous part of each batch.

    numbers: the numbers of the clips of all processes, from `remaining_clips`.
    rank: the number of the process, 0 to num_processes - 1.
    num_processes: a divisor of the batch size.
    """
    if num_processes == 1:
        return numbers
    size = settings.batch_size // num_processes
    starts = range(numbers.start + rank * size, numbers.stop, settings.batch_size)
    return [number for start in starts for number in range(start, start + size)]


def _num_batches(clips: Clips, settings: Settings, steps: int, restarts: Sequence[int]) -> int:
    """The number of batches that the first `steps` steps use. The last batch may be used in part."""
    size, batches, done = settings.batch_size, 0, 0
    while done < steps:
        end = done + max(clips.num_steps(number) for number in range(batches * size, (batches + 1) * size))
        done = min((restart for restart in restarts if done < restart < end), default=end)
        batches += 1
    return batches


@dataclass(frozen=True)
class _ClipDataset(Dataset[Clip | DuoSpaceNetError]):
    """Clips by number. An error is returned as an item, because DataLoader adds a traceback to raised errors."""

    clips: Clips
    config: DuoSpaceNetConfig
    preprocessing: Preprocessing
    settings: Settings

    def __getitem__(self, number: int) -> Clip | DuoSpaceNetError:
        try:
            return self._load(number)
        except DuoSpaceNetError as error:
            return error

    def _load(self, number: int) -> Clip:
        augmentation = sample_augmentation(self.settings, self.config, number)
        tasks = trained_tasks(self.settings, self.config)
        frames = self.clips.frames(number)
        first_trained = len(frames) - self.clips.num_steps(number)
        clip = []
        for index, frame in enumerate(map(augmentation.mirror, frames)):
            wanted = tasks if index >= first_trained else NO_TASKS  # past frames need no ground truth
            training_frame = make_training_frame(frame, self.config, self.preprocessing, wanted)
            clip.append(augmentation.augment_images(training_frame))
        return clip


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C while workers start. A Ctrl-C during the block takes effect at its end.

    The workers inherit the blocked signal. They end together with this process. Without the block, each worker would
    print a traceback on Ctrl-C.
    """
    # multiprocessing starts its resource tracker with the first worker and then unblocks SIGINT. So it is started here,
    # before the signal is blocked.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _allow_many_open_files() -> None:
    """Raise the limit of open files as far as this process may. Workers send each tensor as an open file.

    A worker that reaches the limit would send nothing, and the training would wait for ever.
    """
    _, largest = resource.getrlimit(resource.RLIMIT_NOFILE)
    with suppress(ValueError, OSError):  # macOS refuses its own limit, "unlimited"
        resource.setrlimit(resource.RLIMIT_NOFILE, (largest, largest))


def _remove_worker_exit_handler() -> None:
    """Reset the SIGCHLD handler. DataLoader kills slow workers, and its own handler would report that as a crash."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)


def _initialise_worker(_: int) -> None:
    """Make a worker silent, low in priority and single-threaded.

    Errors reach the training process as items, so stderr is not needed. If training ends early, a thread of
    multiprocessing that sends tensors would print a traceback there.
    """
    sys.stderr = io.StringIO()
    if hasattr(os, "nice"):
        os.nice(WORKER_NICENESS)
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
