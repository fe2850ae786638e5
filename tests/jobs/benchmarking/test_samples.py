"""Percentiles of hand-made samples."""

import math

import numpy as np
import pytest

from duospacenet.jobs.benchmarking.samples import FRAME, Samples, percentiles


def test_percentiles_of_the_numbers_to_100():
    """99 of 100 samples are at most 99, and so on. A thousandth of 100 samples is less than one."""
    found = percentiles(np.random.default_rng(0).permutation(np.arange(1.0, 101.0)).tolist())
    assert (found.p50, found.p90, found.p99, found.p99_9) == (50.0, 90.0, 99.0, None)


@pytest.mark.parametrize("size", [1, 2, 9, 10, 11, 99, 100, 101, 999, 1000, 6636])
def test_a_percentile_is_the_smallest_sample_that_enough_samples_do_not_exceed(size):
    samples = np.random.default_rng(size).uniform(1, 100, size).round(3).tolist()
    found = percentiles(samples)
    for share, value, needed in ((50, found.p50, 1), (90, found.p90, 10), (99, found.p99, 100)):
        if size < needed:
            assert value is None
        else:
            assert value == sorted(samples)[math.ceil(share * size / 100) - 1]
    assert (found.p99_9 is None) == (size < 1000)
    if found.p99_9:
        assert found.p99_9 == sorted(samples)[math.ceil(999 * size / 1000) - 1]


def test_the_tail_of_many_samples_agrees_with_numpy():
    samples = np.random.default_rng(1).gamma(2.0, 50.0, 6636)
    found = percentiles(samples.tolist())
    for value, percent in ((found.p50, 50), (found.p90, 90), (found.p99, 99), (found.p99_9, 99.9)):
        assert value == pytest.approx(np.percentile(samples, percent), rel=0.02)


def test_samples_are_counted_by_stage_and_summarised_by_round():
    samples = Samples()
    samples.add_round([{"backbone": 0.002, FRAME: 0.003}, {"backbone": 0.004, FRAME: 0.009}])
    samples.add_round([{"backbone": 0.003, FRAME: 0.005}])
    assert len(samples) == 3
    assert samples.stages == ["backbone"]
    assert samples.percentiles_ms("backbone").p50 == 3.0
    assert samples.percentiles_ms().p50 == 5.0
    assert samples.round_medians_s == [0.006, 0.005]
