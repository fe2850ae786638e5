"""The error of a tensor inside a graph."""

import numpy as np
import pytest

from duospacenet.export.bisection.deviation import intermediate_error

NAN, INF = np.nan, np.inf


@pytest.mark.parametrize(
    ("actual", "expected", "relative"),
    [
        ([1.0, 2.0], [1.0, 2.0], 0),
        ([NAN, 2.0], [NAN, 2.0], 0),
        ([0.0, 2.0], [NAN, 2.0], 0),
        ([INF, 2.0], [INF, 2.0], 0),
        ([-INF, 2.0], [INF, 2.0], INF),
        ([0.0, 2.0], [INF, 2.0], INF),
        ([NAN, 2.0], [1.0, 2.0], INF),
        ([NAN, 3.0], [NAN, 2.0], 1 / np.sqrt(2)),  # the RMS of 0 and 2 is sqrt(2)
    ],
)
def test_only_values_that_eager_mode_masks_have_no_error(actual, expected, relative):
    arrays = (np.array(values, np.float32) for values in (actual, expected))
    assert intermediate_error("x", *arrays, frame=0).relative == pytest.approx(relative)


def test_another_shape_is_an_error():
    assert intermediate_error("x", np.zeros(2), np.zeros(3), frame=0).relative == INF
