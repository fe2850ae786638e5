"""Random numbers of a training step. They depend on the seed, the step and the clip, and on nothing else.

The number of processes and the length of the training therefore change no random number.
"""

from typing import Literal

import numpy as np
import torch

Purpose = Literal["grid mask", "denoising", "dropout"]
_NUMBERS: dict[Purpose, int] = {"grid mask": 0, "denoising": 1, "dropout": 2}


def random_seed(purpose: Purpose, seed: int, step: int, clip: int, age: int = 0) -> int:
    """The seed of the random numbers for one purpose in one frame; 0 to 2^32 - 1.

    seed: the seed of the training.
    step: the number of the step.
    clip: the number of the clip within the batch of all processes.
    age: 0 for the newest frame of a sample, 1 for the frame before it, and so on.
    """
    # torch's generator uses the lowest 32 bits of its seed only. So the numbers are hashed, not packed into 64 bits.
    return int(np.random.SeedSequence((_NUMBERS[purpose], seed, step, clip, age)).generate_state(1)[0])


def random_generator(purpose: Purpose, seed: int, step: int, clip: int, age: int = 0) -> torch.Generator:
    """A generator (CPU) with the seed `random_seed`."""
    return torch.Generator().manual_seed(random_seed(purpose, seed, step, clip, age))
