"""Which detection finds which truth: hand-worked cases, and a loop over single boxes."""

import numpy as np
import pytest

from duospacenet.evaluation.boxes import EvalBoxes
from duospacenet.evaluation.greedy_matching import UNMATCHED, match_detections
from tests.helpers.evaluation_samples import box, random_sample

LIMITS_M = (0.5, 1.0, 2.0, 4.0)


def cars(*samples: list) -> EvalBoxes:
    """Cars at (x, score), a list of them a sample."""
    return EvalBoxes.concatenated(
        [
            EvalBoxes.of(
                number,
                np.array([box(x) for x, _ in rows]).reshape(-1, 9),
                np.array([s for _, s in rows]),
                ["car"] * len(rows),
            )
            for number, rows in enumerate(samples)
        ]
    )


def found_by(ground_truth: EvalBoxes, found: EvalBoxes, limit_m: float = 2.0) -> dict[int, int]:
    """The row of the truth that each detection found, by row."""
    matches = match_detections(ground_truth, found, (limit_m,))
    return {
        int(row): int(true)
        for row, true in zip(matches.ranked, matches.ground_truth[0], strict=True)
        if true != UNMATCHED
    }


def test_the_higher_score_takes_the_truth_and_its_duplicate_finds_nothing():
    assert found_by(cars([(10, 0)]), cars([(10.1, 0.5), (11, 0.9)])) == {1: 0}


def test_among_equal_scores_the_later_detection_comes_first():
    ground_truth, found = cars([(10, 0)], []), cars([(10.1, 0.5), (10.2, 0.5)], [(10, 0.5)])
    assert match_detections(ground_truth, found, (2.0,)).ranked.tolist() == [2, 1, 0]
    assert found_by(ground_truth, found) == {1: 0}


def test_a_detection_whose_nearest_truth_is_taken_finds_the_next_one_within_the_limit():
    ground_truth, found = cars([(10, 0), (11.5, 0)]), cars([(10, 0.9), (10.2, 0.8)])
    assert found_by(ground_truth, found, 2.0) == {0: 0, 1: 1}
    assert found_by(ground_truth, found, 1.0) == {0: 0}


def test_a_detection_takes_the_nearest_truth_though_another_needs_it_more():
    assert found_by(cars([(10, 0), (12, 0)]), cars([(11.2, 0.9), (13.5, 0.8)])) == {0: 1}


def test_of_two_truths_equally_near_the_first_is_taken():
    assert found_by(cars([(11, 0), (9, 0)]), cars([(10, 0.9)])) == {0: 0}


def test_a_truth_exactly_at_the_limit_is_not_found():
    assert found_by(cars([(10, 0)]), cars([(12, 0.9)]), 2.0) == {}
    assert found_by(cars([(10, 0)]), cars([(12, 0.9)]), 2.001) == {0: 0}


def test_a_truth_of_another_sample_is_not_found():
    assert found_by(cars([(10, 0)], []), cars([], [(10, 0.9)])) == {}


@pytest.mark.parametrize("seed", range(5))
def test_all_samples_at_once_match_as_one_box_after_the_other(seed):
    rng = np.random.default_rng(seed)
    samples = [random_sample(rng, num_true=25, num_false=30) for _ in range(12)]
    ground_truth = _of_one_class([(s.ground_truth.boxes, np.zeros(25)) for s in samples])
    found = _of_one_class([(s.detections.boxes, s.detections.scores) for s in samples])
    matches = match_detections(ground_truth, found, LIMITS_M)
    for limit_m, matched in zip(LIMITS_M, matches.ground_truth, strict=True):
        expected = looped(ground_truth, found, limit_m)
        assert dict(zip(matches.ranked.tolist(), matched.tolist(), strict=True)) == expected
        assert len([row for row in expected.values() if row != UNMATCHED]) > 20


def looped(ground_truth: EvalBoxes, found: EvalBoxes, limit_m: float) -> dict[int, int]:
    """The published algorithm, box after box."""
    taken, matched = set(), {}
    ascending = sorted((score, row) for row, score in enumerate(found.score.tolist()))
    for _, row in reversed(ascending):
        nearest, nearest_m = UNMATCHED, np.inf
        for true_row in range(len(ground_truth)):
            if ground_truth.sample[true_row] == found.sample[row] and true_row not in taken:
                distance_m = np.linalg.norm(
                    ground_truth.values[true_row, :2] - found.values[row, :2].astype(np.float64)
                )
                if distance_m < nearest_m:
                    nearest, nearest_m = true_row, distance_m
        matched[row] = nearest if nearest_m < limit_m else UNMATCHED
        taken |= {matched[row]} - {UNMATCHED}
    return matched


def _of_one_class(samples: list) -> EvalBoxes:
    return EvalBoxes.concatenated(
        [EvalBoxes.of(number, values, scores, ["car"] * len(values)) for number, (values, scores) in enumerate(samples)]
    )
