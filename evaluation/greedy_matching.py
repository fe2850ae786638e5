"""Which detection finds which truth, as nuscenes-devkit's `accumulate` decides it.

The detections of a class come in descending score over all samples; among equal scores the later one comes first.
Each takes the nearest truth of its sample that is still free, and finds it if it is nearer than the limit. What
happens in one sample touches no other, so the first detections of all samples are matched at once, then the second.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .boxes import EvalBoxes

UNMATCHED = -1


class Matches(NamedTuple):
    """ranked: (D,) rows of the detections, best first. truth: (K, D), for each limit and ranked detection the row of
    the truth that it found, or UNMATCHED.
    """

    ranked: NDArray[np.int64]
    ground_truth: NDArray[np.int64]


class _Grid(NamedTuple):
    """True boxes by sample: a row a sample that has any, filled up with boxes at infinity.

    samples: (S,) ascending. rows: (S, G) of the true boxes. centres: (S, G, 2) [m].
    """

    samples: NDArray[np.int32]
    rows: NDArray[np.int64]
    centres: NDArray[np.float64]


def match_detections(ground_truth: EvalBoxes, found: EvalBoxes, limits_m: Sequence[float]) -> Matches:
    """Match detections and true boxes of one class at each of K limits."""
    ranked = np.argsort(found.score, kind="stable")[::-1]
    matched = np.full((len(limits_m), len(ranked)), UNMATCHED)
    if len(ground_truth) == 0:
        return Matches(ranked, matched)
    grid = _by_sample(ground_truth)
    taken = np.zeros((len(limits_m), *grid.rows.shape), np.bool_)
    centres, samples = found.values[ranked, :2].astype(np.float64), found.sample[ranked]
    judged = np.flatnonzero(np.isin(samples, grid.samples))
    for turn in _turns(samples[judged]):
        at = judged[turn]
        lines = np.searchsorted(grid.samples, samples[at])
        distances_m = np.sqrt(np.sum((grid.centres[lines] - centres[at, None]) ** 2, axis=2))
        for k, limit_m in enumerate(limits_m):
            free_m = np.where(taken[k, lines], np.inf, distances_m)
            nearest = free_m.argmin(axis=1)
            hit = free_m[np.arange(len(at)), nearest] < limit_m
            taken[k, lines[hit], nearest[hit]] = True
            matched[k, at[hit]] = grid.rows[lines[hit], nearest[hit]]
    return Matches(ranked, matched)


def _by_sample(ground_truth: EvalBoxes) -> _Grid:
    order = np.argsort(ground_truth.sample, kind="stable")
    samples, counts = np.unique(ground_truth.sample, return_counts=True)
    column = np.arange(len(ground_truth)) - np.repeat(np.cumsum(counts) - counts, counts)
    line = np.repeat(np.arange(len(samples)), counts)
    rows = np.full((len(samples), counts.max()), UNMATCHED)
    centres = np.full((*rows.shape, 2), np.inf)
    rows[line, column], centres[line, column] = order, ground_truth.values[order, :2]
    return _Grid(samples, rows, centres)


def _turns(samples: NDArray[np.int32]) -> Iterator[NDArray[np.int64]]:
    """Positions in `samples`: the first of every sample, then the second of every one that has two, and so on."""
    by_sample = np.argsort(samples, kind="stable")
    _, counts = np.unique(samples, return_counts=True)
    turn = np.arange(len(samples)) - np.repeat(np.cumsum(counts) - counts, counts)
    by_turn = np.argsort(turn, kind="stable")
    ends = np.cumsum(np.bincount(turn))
    return (by_sample[by_turn[start:end]] for start, end in zip([0, *ends], ends, strict=False))
