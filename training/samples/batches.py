"""Batches of clips, of which each process trains a part."""

from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

from ..settings import Settings
from .clips import Clips
from .training_frames import Clip


class Batch(NamedTuple):
    """The part of a batch that one process trains.

    clips: the clips of this process.
    num_steps: the number of samples of every clip of the batch, in all processes.
    """

    clips: list[Clip]
    num_steps: list[int]


def make_batches(
    loaded: Iterator[Clip], clips: Clips, numbers: range, settings: Settings, num_processes: int = 1
) -> Iterator[Batch]:
    """Group the loaded clips of one process into batches.

    loaded: the clips of this process, see `clips_of_process`.
    clips: the sequence that they come from.
    numbers: the numbers of the clips of all processes.
    num_processes: a divisor of the batch size.
    """
    size = settings.batch_size
    for start in range(numbers.start, numbers.stop, size):
        part = list(islice(loaded, size // num_processes))
        yield Batch(part, [clips.num_steps(number) for number in range(start, start + size)])
