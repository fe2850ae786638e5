"""Tests of the random numbers of a step."""

from itertools import product

import torch

from duospacenet.training.random_numbers import random_generator, random_seed


def test_purposes_seeds_steps_clips_and_ages_have_different_random_numbers():
    """Also numbers that differ by 2^32, of which torch's generator ignores the upper bits."""
    cases = product(("grid mask", "denoising", "dropout"), (0, 1), (0, 1, 2**32), (0, 1), (0, 1))
    first = [float(torch.rand((), generator=random_generator(*case))) for case in cases]
    assert len(set(first)) == len(first) == 72


def test_the_same_numbers_give_the_same_seed():
    assert random_seed("denoising", 3, 17, 2) == random_seed("denoising", 3, 17, 2)
    assert 0 <= random_seed("denoising", 999, 10**9, 10**4) < 2**32
