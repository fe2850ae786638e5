"""Angles as text."""

from duospacenet.rig.formatting import describe_roll


def test_a_roll_that_rounds_to_zero_has_no_minus_sign():
    assert describe_roll(-0.01) == ", rolled by 0.0 degrees"
    assert describe_roll(-12.34) == ", rolled by -12.3 degrees"
