"""Greedy matching of detections to ground truth, with the rules of `accumulate` in nuscenes-devkit.

The detections of a class are processed in descending order of score, over all samples. If scores are equal, the later
detection is processed first. Each detection is compared with the nearest unmatched ground-truth box of its sample. They
match if their distance is below the matching distance.

Samples do not influence each other. Therefore this implementation processes the first detection of every sample in one
pass, then the second one of every sample, and so on. The result equals that of the devkit's loop over single boxes.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .boxes import EvalBoxes

UNMATCHED = -1


class Matches(NamedTuple):
    """The matches of D detections at K matching distances.

    ranked: (D,) row numbers of the detections, in descending order of score.
    ground_truth: (K, D) row number of the ground-truth box that each ranked detection matches, or UNMATCHED.
    """

    ranked: NDArray[np.int64]
    ground_truth: NDArray[np.int64]


class _PaddedTruth(NamedTuple):
    """The ground-truth boxes of S samples, padded to G boxes per sample with boxes at infinity.

    samples: (S,) numbers of the samples that have boxes, ascending.
    rows: (S, G) row numbers of the boxes, or UNMATCHED.
    centres: (S, G, 2) [m].
    """

    samples: NDArray[np.int32]
    rows: NDArray[np.int64]
    centres: NDArray[np.float64]


def match_detections(ground_truth: EvalBoxes, detections: EvalBoxes, distances_m: Sequence[float]) -> Matches:
    """Match detections and ground truth of one class, at each of K matching distances [m]."""
    # Reversing a stable ascending sort puts the later of two equal scores first, as in the devkit.
    ranked = np.argsort(detections.score, kind="stable")[::-1]
    matched = np.full((len(distances_m), len(ranked)), UNMATCHED)
    if len(ground_truth) == 0:
        return Matches(ranked, matched)
    truth = _pad_by_sample(ground_truth)
    is_taken = np.zeros((len(distances_m), *truth.rows.shape), np.bool_)
    centres, samples = detections.values[ranked, :2].astype(np.float64), detections.sample[ranked]
    candidates = np.flatnonzero(np.isin(samples, truth.samples))
    for positions in _passes(samples[candidates]):
        at = candidates[positions]
        lines = np.searchsorted(truth.samples, samples[at])
        offsets_m = np.sqrt(np.sum((truth.centres[lines] - centres[at, None]) ** 2, axis=2))
        for k, distance_m in enumerate(distances_m):
            free_m = np.where(is_taken[k, lines], np.inf, offsets_m)
            nearest = free_m.argmin(axis=1)
            is_match = free_m[np.arange(len(at)), nearest] < distance_m
            is_taken[k, lines[is_match], nearest[is_match]] = True
            matched[k, at[is_match]] = truth.rows[lines[is_match], nearest[is_match]]
    return Matches(ranked, matched)


def _pad_by_sample(ground_truth: EvalBoxes) -> _PaddedTruth:
    order = np.argsort(ground_truth.sample, kind="stable")
    samples, counts = np.unique(ground_truth.sample, return_counts=True)
    column = np.arange(len(ground_truth)) - np.repeat(np.cumsum(counts) - counts, counts)
    line = np.repeat(np.arange(len(samples)), counts)
    rows = np.full((len(samples), counts.max()), UNMATCHED)
    centres = np.full((*rows.shape, 2), np.inf)
    rows[line, column], centres[line, column] = order, ground_truth.values[order, :2]
    return _PaddedTruth(samples, rows, centres)


def _passes(samples: NDArray[np.int32]) -> Iterator[NDArray[np.int64]]:
    """Yield the positions of the first detection of every sample, then of the second ones, and so on.

    samples: (D,) the sample of each detection.
    """
    by_sample = np.argsort(samples, kind="stable")
    _, counts = np.unique(samples, return_counts=True)
    number = np.arange(len(samples)) - np.repeat(np.cumsum(counts) - counts, counts)  # within its sample
    by_number = np.argsort(number, kind="stable")
    ends = np.cumsum(np.bincount(number))
    return (by_sample[by_number[start:end]] for start, end in zip([0, *ends], ends, strict=False))
