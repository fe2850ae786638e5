"""Rendered clips: training clips and held-out drives in files, rendered once for several trainings.

Processes that train at the same time map the same files into memory, so the images are in memory once.
"""

import pickle
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cached_property, partial
from multiprocessing import get_context
from pathlib import Path

import cv2
import torch

from duospacenet.model import DuoSpaceNetConfig
from duospacenet.runtime.files import atomic_path
from duospacenet.runtime.frame import Frame
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.training.samples.synthetic_clips import SyntheticClips
from duospacenet.training.samples.training_frames import Clip, TrainingFrame, make_training_frame
from duospacenet.weights.input_contract import preprocessing


class RenderedClips:
    """The files of a folder.

    clips: the sequence that the clips are rendered from.
    num_clips: how many of them are used.
    held_out: seed and number of frames of each held-out drive.
    """

    def __init__(
        self, folder: Path, clips: SyntheticClips, num_clips: int, held_out: tuple[tuple[int, int], ...]
    ) -> None:
        self.folder = folder
        self.clips = clips
        self.num_clips = num_clips
        self.held_out = held_out

    def render(self, config: DuoSpaceNetConfig, workers: int) -> None:
        """Render all files that are missing, in `workers` processes. config: of the model that is trained."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with ProcessPoolExecutor(workers, get_context("spawn"), _use_one_thread) as pool:
            drives = pool.map(partial(_render_drive, self), self.held_out)
            for _ in pool.map(partial(_render_clip, self, config), range(self.num_clips)):
                pass
            list(drives)  # raises the first error

    def clip(self, number: int) -> Clip:
        """Clip `number`. Its tensors are parts of the file."""
        tensors = torch.load(self.clip_path(number), mmap=True, weights_only=True)
        return [TrainingFrame(*frame) for frame in tensors]

    @cached_property
    def held_out_drives(self) -> list[list[Frame]]:
        """The frames of each held-out drive."""
        return [pickle.loads(self.drive_path(*drive).read_bytes()) for drive in self.held_out]

    def missing(self) -> Iterator[Path]:
        """The files that are not rendered yet."""
        paths = [*map(self.clip_path, range(self.num_clips)), *(self.drive_path(*drive) for drive in self.held_out)]
        return (path for path in paths if not path.exists())

    def clip_path(self, number: int) -> Path:
        """The file of a training clip."""
        return self.folder / f"clip-{number:05d}.pt"

    def drive_path(self, seed: int, num_frames: int) -> Path:
        """The file of a held-out drive."""
        return self.folder / f"held-out-{seed}-{num_frames}.pickle"


def _render_clip(rendered: RenderedClips, config: DuoSpaceNetConfig, number: int) -> None:
    path, contract = rendered.clip_path(number), preprocessing(config)
    if not path.exists():
        frames = [make_training_frame(frame, config, contract) for frame in rendered.clips.frames(number)]
        with atomic_path(path) as temporary:
            torch.save([tuple(frame) for frame in frames], temporary)


def _render_drive(rendered: RenderedClips, drive: tuple[int, int]) -> None:
    seed, num_frames = drive
    path = rendered.drive_path(seed, num_frames)
    if not path.exists():
        frames = list(SyntheticDrive(seed, num_frames, grid=rendered.clips.grid))
        with atomic_path(path) as temporary:
            temporary.write_bytes(pickle.dumps(frames))


def _use_one_thread() -> None:
    torch.set_num_threads(1)
    cv2.setNumThreads(1)
