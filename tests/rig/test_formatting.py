"""Angles as text."""

import numpy as np

from duospacenet.rig.formatting import describe_position, describe_roll


def test_a_roll_that_rounds_to_zero_has_no_minus_sign():
    assert describe_roll(-0.01) == ", rolled by 0.0 degrees"
    assert describe_roll(-12.34) == ", rolled by -12.3 degrees"


def test_a_position_that_rounds_to_zero_has_no_minus_sign():
    assert describe_position(np.array([1.504, -0.0, -0.001])) == "x 1.50, y 0.00, z 0.00 m"
