"""What the tests of training share: drawn frames as a tiny model learns from them, and trainers that begin alike."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import chain

import numpy as np
import torch

from duospacenet.model import PRESETS, DuoSpaceNet, DuoSpaceNetConfig
from duospacenet.runtime import Frame
from duospacenet.synthetic.drive import SyntheticDrive
from duospacenet.training import Settings, Trainer, initialise
from duospacenet.training.training_frames import TrainingFrame, make_training_frame
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.streams import TINY_SIZE_PX

TINY = PRESETS["tiny"]
CPU = torch.device("cpu")


@cache
def synthetic_frames(seed: int, num_frames: int) -> tuple[Frame, ...]:
    """Frames of one scene, with maps of the tiny model's grid; drawn once. Tests that change one take a copy."""
    return tuple(SyntheticDrive(seed, num_frames, image_size=TINY_SIZE_PX, grid=TINY.voxels.size[:2]))


def synthetic_training_frames(seed: int, num_frames: int, config: DuoSpaceNetConfig = TINY) -> list[TrainingFrame]:
    """The same as tensors; config: the tiny model's, or an ablation of it."""
    return [make_training_frame(frame, config, preprocessing(config)) for frame in synthetic_frames(seed, num_frames)]


def settings_with(**changes) -> Settings:
    """Few steps of one drive of two frames each, in float32."""
    few = {"steps": 4, "batch_size": 1, "frames_per_clip": 2, "warmup_steps": 0, "bf16": False}
    return Settings(**few | changes)


def new_trainer(settings: Settings, config: DuoSpaceNetConfig = TINY) -> Trainer:
    return Trainer(initialise(DuoSpaceNet(config), settings.seed), settings, CPU)


@dataclass(frozen=True)
class FixedClips:
    """Drives of frames that are there already, over and over."""

    drives: tuple[Sequence[Frame], ...]
    identity: str = "given frames"

    def frames(self, number: int) -> list[Frame]:
        return list(self.drives[number % len(self.drives)])

    def length(self, number: int) -> int:
        return len(self.frames(number))

    def ground_truth_centres(self) -> Iterator[np.ndarray]:
        return (
            frame.ground_truth.boxes[:, :3]
            for frame in chain.from_iterable(self.drives)
            if frame.ground_truth is not None
        )


@dataclass(frozen=True)
class FixedSource:
    """A source of frames that are there already."""

    given: Sequence[Frame]
    identity: str = "given frames"

    def __iter__(self):
        return iter(self.given)

    def __len__(self) -> int:
        return len(self.given)

    def frame(self, index: int) -> Frame:
        return self.given[index]

    def frame_without_images(self, index: int) -> Frame:
        frame = self.given[index]
        return replace(frame, images=dict.fromkeys(frame.images), ground_truth=None)

    def ground_truth_boxes(self, index: int) -> np.ndarray | None:
        ground_truth = self.given[index].ground_truth
        return None if ground_truth is None else ground_truth.boxes
