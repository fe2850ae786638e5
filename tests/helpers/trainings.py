"""Helpers of the training tests: synthetic frames for the tiny model, trainers, and fixed clips and sources."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain
from pathlib import Path

import torch

from duospacenet.model import PRESETS, DuoSpaceNet, DuoSpaceNetConfig
from duospacenet.runtime import Frame, GroundTruth
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.training import Settings, Trainer, TrainingFolder, TrainingRecord, initialise, train
from duospacenet.training.distributed import Processes
from duospacenet.training.samples.batches import make_batches
from duospacenet.training.samples.clip_loader import load_clips, remaining_clips
from duospacenet.training.samples.clips import Clips
from duospacenet.training.samples.training_frames import TrainingFrame, make_training_frame
from duospacenet.training.trainer import TrainingStep
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.streams import TINY_SIZE_PX

TINY = PRESETS["tiny"]
CPU = torch.device("cpu")


@cache
def synthetic_frames(seed: int, num_frames: int) -> tuple[Frame, ...]:
    """Frames of one synthetic scene, with maps of the tiny model's grid. Cached: copy a frame before changing it."""
    return tuple(SyntheticDrive(seed, num_frames, image_size=TINY_SIZE_PX, grid=TINY.voxels.size[:2]))


def synthetic_training_frames(seed: int, num_frames: int, config: DuoSpaceNetConfig = TINY) -> list[TrainingFrame]:
    """The same frames as tensors. config: of the tiny model, or of an ablation of it."""
    return [make_training_frame(frame, config, preprocessing(config)) for frame in synthetic_frames(seed, num_frames)]


def settings_with(**changes) -> Settings:
    """Four steps in float32, with one clip of two frames per batch, and these changes."""
    short = {"steps": 4, "batch_size": 1, "frames_per_clip": 2, "warmup_steps": 0, "amp": "off"}
    short |= {"learning_rate": 2e-4, "backbone_learning_rate": 2e-4, "auxiliary_matches": 1}
    return Settings(**short | changes)


def new_trainer(
    settings: Settings,
    config: DuoSpaceNetConfig = TINY,
    processes: Processes | None = None,
    accumulation_steps: int = 1,
) -> Trainer:
    model = initialise(DuoSpaceNet(config), settings.seed)
    return Trainer(model, settings, processes or CPU, accumulation_steps)


SIX_STEPS = settings_with(steps=6, auxiliary_matches=2, grid_mask=0.5)


def record_with(settings: Settings = SIX_STEPS, config: DuoSpaceNetConfig = TINY) -> TrainingRecord:
    return TrainingRecord(config, settings, "fixed clips", "random")


def start_training_folder(path: Path, config: DuoSpaceNetConfig = TINY) -> TrainingFolder:
    """A new folder with the record of `record_with()`."""
    path.mkdir()
    folder = TrainingFolder(path, record_with(config=config))
    folder.write_record()
    return folder


def continue_training(
    folder: TrainingFolder, trainer: Trainer, clips: Clips, save_every: int = 1
) -> Iterator[TrainingStep]:
    """Resume from the folder and train to the end."""
    folder.resume(trainer)
    numbers = remaining_clips(clips, trainer.settings, trainer.step)
    loaded = load_clips(clips, TINY, preprocessing(TINY), numbers, workers=0)
    return train(trainer, folder, make_batches(loaded, clips, numbers, trainer.settings), save_every)


@dataclass(frozen=True)
class FixedClips:
    """The given clips, repeated without end."""

    clips: tuple[Sequence[Frame], ...]
    identity: str = "fixed clips"

    def frames(self, number: int) -> list[Frame]:
        return list(self.clips[number % len(self.clips)])

    @property
    def samples_per_epoch(self) -> int:
        return sum(map(len, self.clips))

    def num_steps(self, number: int) -> int:
        return len(self.frames(number))

    def ground_truth(self) -> Iterator[GroundTruth]:
        return (frame.ground_truth for frame in chain.from_iterable(self.clips) if frame.ground_truth is not None)


@dataclass(frozen=True)
class FixedSource:
    """A source of the given frames."""

    given: Sequence[Frame]
    identity: str = "fixed frames"

    def __iter__(self):
        return iter(self.given)

    def __len__(self) -> int:
        return len(self.given)

    def frame(self, index: int) -> Frame:
        return self.given[index]

    def frame_without_images(self, index: int) -> Frame:
        frame = self.given[index]
        return replace(frame, images=dict.fromkeys(frame.images), ground_truth=None)

    @property
    def tokens(self) -> Iterator[str]:
        return (frame.token for frame in self.given)

    def scene_name(self, index: int) -> str:
        return self.given[index].scene

    def check_image_files(self, index: int) -> tuple[str, ...]:
        return tuple(name for name, image in self.given[index].images.items() if image is None)

    def has_boxes(self, index: int) -> bool:
        truth = self.given[index].ground_truth
        return truth is not None and truth.has_boxes

    def has_maps(self, index: int) -> bool:
        truth = self.given[index].ground_truth
        return truth is not None and bool(truth.maps)

    def map_names(self, index: int) -> frozenset[str]:
        truth = self.given[index].ground_truth
        return frozenset() if truth is None else frozenset(truth.maps)

    def check_class_names(self, classes: Collection[str]) -> None:
        """All names are known."""

    def ground_truth_without_maps(self, index: int) -> GroundTruth | None:
        return self.given[index].ground_truth
