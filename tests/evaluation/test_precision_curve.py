"""Average precision and mean errors of one class, in cases worked by hand."""

import numpy as np
import pytest

from duospacenet.evaluation.precision_curve import RECALL, PrecisionCurve, cumulative_mean
from duospacenet.evaluation.protocol import ERRORS

NAN = float("nan")


def curve(
    scores: list[float], is_match: list[int], num_truth: int, errors: list[float] | None = None
) -> PrecisionCurve:
    """A curve with these values for each of the five errors."""
    values = np.array([0.0] * sum(is_match) if errors is None else errors)
    return PrecisionCurve.from_matches(
        np.array(scores), np.array(is_match, bool), dict.fromkeys(ERRORS, values), num_truth
    )


def test_only_true_positives_and_full_recall_give_an_average_precision_of_1():
    assert curve([0.9, 0.8], [1, 1], 2).average_precision == pytest.approx(1)


def test_at_a_repeated_recall_the_last_precision_counts():
    """Recalls 1/2, 1/2, 1 and precisions 1, 1/2, 2/3.

    Of the 90 recalls above 0.1, the 39 below 1/2 have precision 1. The other 51 average (1/2 + 2/3) / 2.
    """
    one = curve([0.9, 0.8, 0.7], [1, 0, 1], 2)
    assert one.precision[50] == pytest.approx(1 / 2)
    assert one.average_precision == pytest.approx((39 * 0.9 + 51 * (7 / 12 - 0.1)) / 90 / 0.9)


def test_precision_is_0_beyond_the_largest_recall():
    """One of two true boxes is detected: precision is 1 up to a recall of 1/2, at 40 of the 90 recalls."""
    one = curve([0.9], [1], 2)
    assert RECALL[one.max_recall_index] == 0.5
    assert one.average_precision == pytest.approx(40 / 90)


def test_a_precision_below_one_tenth_adds_nothing():
    assert curve([0.9 - 0.01 * i for i in range(20)], [0] * 19 + [1], 1).average_precision == 0


def test_an_error_is_the_mean_over_recalls_of_the_cumulative_mean():
    """Errors 1 and 3 at recalls 1/2 and 1: their cumulative means are 1 and 2.

    The mean is 1 up to a recall of 1/2 and linear from there: 39 times 1, and 51 times 1.5.
    """
    assert curve([0.8, 0.4], [1, 1], 2, [1, 3]).mean_error("scale") == pytest.approx((39 * 1 + 51 * 1.5) / 90)


def test_an_error_is_averaged_up_to_the_largest_recall_reached():
    assert curve([0.8, 0.4], [1, 1], 4, [1, 3]).mean_error("scale") == pytest.approx((14 * 1 + 26 * 1.5) / 40, rel=1e-9)


@pytest.mark.parametrize(("num_truth", "expected"), [(9, 0.5), (10, 1.0), (11, 1.0)])
def test_an_error_is_1_if_recall_does_not_exceed_one_tenth(num_truth, expected):
    assert curve([0.8], [1], num_truth, [0.5]).mean_error("translation") == expected


@pytest.mark.parametrize("empty", [curve([], [], 3), curve([0.9], [0], 3), curve([0.9], [0], 0), curve([], [], 0)])
def test_without_ground_truth_or_matches_precision_is_0_and_every_error_1(empty):
    assert empty.average_precision == 0
    assert [empty.mean_error(name) for name in ERRORS] == [1, 1, 1, 1, 1]


def test_a_match_with_score_0_does_not_count_as_reaching_its_recall():
    """nuScenes takes the last recall with a confidence above 0 as the largest one reached."""
    assert RECALL[curve([0.8, 0.0], [1, 1], 2).max_recall_index] == 0.99
    assert curve([0.0], [1], 1, [0.5]).mean_error("scale") == 1


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ([2, 4, 9], [2, 3, 5]),
        ([NAN, 4, NAN, 6], [0, 4, 4, 5]),
        ([NAN, NAN], [1, 1]),
        ([], []),
    ],
)
def test_a_cumulative_mean_leaves_out_nan(values, expected):
    assert cumulative_mean(np.array(values, float)).tolist() == expected
