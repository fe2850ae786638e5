"""Greedy matching: cases worked by hand, and comparison with a loop over single boxes."""

import numpy as np
import pytest

from duospacenet.evaluation.boxes import EvalBoxes
from duospacenet.evaluation.greedy_matching import UNMATCHED, _passes, match_detections
from tests.helpers.evaluation_samples import box, random_sample

DISTANCES_M = (0.5, 1.0, 2.0, 4.0)


def cars(*samples: list) -> EvalBoxes:
    """Cars at (x, score), one list per sample."""
    return EvalBoxes.concatenate(
        [
            EvalBoxes.of_sample(
                number,
                np.array([box(x) for x, _ in rows]).reshape(-1, 9),
                np.array([s for _, s in rows]),
                ["car"] * len(rows),
            )
            for number, rows in enumerate(samples)
        ]
    )


def matched_rows(ground_truth: EvalBoxes, detections: EvalBoxes, distance_m: float = 2.0) -> dict[int, int]:
    """The row of the matched true box by the row of the detection."""
    matches = match_detections(ground_truth, detections, (distance_m,))
    return {
        int(row): int(true)
        for row, true in zip(matches.ranked, matches.ground_truth[0], strict=True)
        if true != UNMATCHED
    }


def test_the_higher_score_matches_and_its_duplicate_does_not():
    assert matched_rows(cars([(10, 0)]), cars([(10.1, 0.5), (11, 0.9)])) == {1: 0}


def test_among_equal_scores_the_later_detection_comes_first():
    ground_truth, detections = cars([(10, 0)], []), cars([(10.1, 0.5), (10.2, 0.5)], [(10, 0.5)])
    assert match_detections(ground_truth, detections, (2.0,)).ranked.tolist() == [2, 1, 0]
    assert matched_rows(ground_truth, detections) == {1: 0}


def test_if_the_nearest_true_box_is_taken_the_next_one_within_the_distance_matches():
    ground_truth, detections = cars([(10, 0), (11.5, 0)]), cars([(10, 0.9), (10.2, 0.8)])
    assert matched_rows(ground_truth, detections, 2.0) == {0: 0, 1: 1}
    assert matched_rows(ground_truth, detections, 1.0) == {0: 0}


def test_matching_is_greedy_even_if_another_detection_then_has_no_match():
    assert matched_rows(cars([(10, 0), (12, 0)]), cars([(11.2, 0.9), (13.5, 0.8)])) == {0: 1}


def test_of_two_equally_near_true_boxes_the_first_matches():
    assert matched_rows(cars([(11, 0), (9, 0)]), cars([(10, 0.9)])) == {0: 0}


def test_a_true_box_exactly_at_the_matching_distance_does_not_match():
    assert matched_rows(cars([(10, 0)]), cars([(12, 0.9)]), 2.0) == {}
    assert matched_rows(cars([(10, 0)]), cars([(12, 0.9)]), 2.001) == {0: 0}


def test_a_true_box_of_another_sample_does_not_match():
    assert matched_rows(cars([(10, 0)], []), cars([], [(10, 0.9)])) == {}


@pytest.mark.parametrize("seed", range(5))
def test_the_result_equals_that_of_a_loop_over_single_boxes(seed):
    rng = np.random.default_rng(seed)
    samples = [random_sample(rng, num_true=25, num_false=30) for _ in range(12)]
    ground_truth = _of_one_class([(s.ground_truth.boxes, np.zeros(25)) for s in samples])
    detections = _of_one_class([(s.detections.boxes, s.detections.scores) for s in samples])
    matches = match_detections(ground_truth, detections, DISTANCES_M)
    for distance_m, matched in zip(DISTANCES_M, matches.ground_truth, strict=True):
        expected = match_one_by_one(ground_truth, detections, distance_m)
        assert dict(zip(matches.ranked.tolist(), matched.tolist(), strict=True)) == expected
        assert len([row for row in expected.values() if row != UNMATCHED]) > 20


def match_one_by_one(ground_truth: EvalBoxes, detections: EvalBoxes, distance_m: float) -> dict[int, int]:
    """The published algorithm as a loop over single boxes."""
    taken, matched = set(), {}
    ascending = sorted((score, row) for row, score in enumerate(detections.score.tolist()))
    for _, row in reversed(ascending):
        nearest, nearest_m = UNMATCHED, np.inf
        for true_row in range(len(ground_truth)):
            if ground_truth.sample[true_row] == detections.sample[row] and true_row not in taken:
                offset_m = np.linalg.norm(
                    ground_truth.values[true_row, :2] - detections.values[row, :2].astype(np.float64)
                )
                if offset_m < nearest_m:
                    nearest, nearest_m = true_row, offset_m
        matched[row] = nearest if nearest_m < distance_m else UNMATCHED
        taken |= {matched[row]} - {UNMATCHED}
    return matched


@pytest.mark.parametrize("num_samples", [3, 3000])
def test_the_number_of_passes_is_the_largest_number_of_detections_in_a_sample(num_samples):
    """It does not depend on the number of samples: a loop over single boxes would need 7 per sample."""
    passes = list(_passes(np.repeat(np.arange(num_samples, dtype=np.int32), 7)))
    assert [len(positions) for positions in passes] == [num_samples] * 7


def _of_one_class(samples: list) -> EvalBoxes:
    return EvalBoxes.concatenate(
        [
            EvalBoxes.of_sample(number, values, scores, ["car"] * len(values))
            for number, (values, scores) in enumerate(samples)
        ]
    )
