"""Errors of tensors equal values computed by hand."""

import numpy as np
import pytest

from duospacenet.runtime.parity.tensor_error import TensorError


def test_the_relative_error_is_the_absolute_error_over_the_rms_of_the_reference():
    error = TensorError.between(np.array([3.0, 4.5]), np.array([3.0, 4.0]))
    assert error.absolute == 0.5
    assert error.relative == pytest.approx(0.5 / np.sqrt(12.5))
    assert error.cosine == pytest.approx((9 + 18) / (5 * np.hypot(3, 4.5)))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_nan_or_infinity_on_either_side_or_both_is_an_infinite_error(value):
    good, bad = np.ones(2), np.array([1.0, value])
    for actual, expected in ((bad, good), (good, bad), (bad, bad)):
        error = TensorError.between(actual, expected)
        assert (error.absolute, error.relative, error.cosine) == (np.inf, np.inf, -1)


def test_only_zeros_equal_a_reference_of_zeros():
    assert TensorError.between(np.zeros(3), np.zeros(3)).relative == 0
    assert TensorError.between(np.full(3, 1e-9), np.zeros(3)).relative == np.inf


def test_another_shape_is_an_infinite_error():
    assert TensorError.between(np.ones((2, 1)), np.ones((1, 2))).relative == np.inf


def test_boxes_are_compared_column_by_column_and_yaw_wraps_around():
    """An error of 0.01 rad is 0.1 of a yaw RMS of 0.1 rad, independent of the positions in metres."""
    expected = np.tile(np.array([[40.0, 30, 1, 2, 4, 1.5, 0.1, 5, 1]]), (4, 1))
    rotated = expected.copy()
    rotated[2, 6] += 0.01
    assert TensorError.between_boxes(rotated, expected).relative == pytest.approx(0.1)
    turned = expected.copy()
    turned[:, 6] += 2 * np.pi
    assert TensorError.between_boxes(turned, expected).relative == pytest.approx(0, abs=1e-12)


def test_the_yaw_of_a_short_heading_vector_counts_by_its_length():
    """Errors of 0.01 rad: across a vector of length 0.02 it is 0.0002, across one of length 3 it stays 0.01."""
    expected = np.tile(np.array([[40.0, 30, 1, 2, 4, 1.5, 0.1, 5, 1]]), (2, 1))
    for query, difference in ((0, 0.0002), (1, 0.01)):
        rotated = expected.copy()
        rotated[query, 6] += 0.01
        error = TensorError.between_outputs("boxes", rotated, expected, heading=np.array([0.02, 3.0]))
        assert error.absolute == pytest.approx(difference)
        assert error.relative == pytest.approx(difference / 0.1)


def test_only_the_yaw_counts_by_the_length_of_the_heading_vector():
    expected = np.ones((1, 9))
    moved = expected + np.eye(9)[:1] * 0.5
    assert TensorError.between_outputs("boxes", moved, expected, heading=np.zeros(1)).absolute == 0.5


def test_the_worst_error_keeps_its_frame():
    errors = [TensorError(1.0, 0.5, 1.0, frame=3), TensorError(0.5, 0.9, 1.0, frame=7)]
    assert TensorError.worst(errors).frame == 7
