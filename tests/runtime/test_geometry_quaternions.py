"""Conversion between quaternions and rotation matrices."""

import numpy as np

from duospacenet.runtime.geometry import quaternion_from_rotation, rotation_from_quaternion


def test_quaternions_of_known_rotations_and_round_trips():
    # A quarter turn about z, a half turn (w is 0), and round trips of random rotations.
    half = np.sqrt(0.5)
    np.testing.assert_allclose(
        rotation_from_quaternion(np.array([half, 0, 0, half])), [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12
    )
    np.testing.assert_allclose(np.abs(quaternion_from_rotation(np.diag([-1.0, -1.0, 1.0]))), [0, 0, 0, 1], atol=1e-12)
    rng = np.random.default_rng(1)
    for numbers in rng.normal(size=(50, 4)):
        rotation = rotation_from_quaternion(numbers / np.linalg.norm(numbers))
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(rotation_from_quaternion(quaternion_from_rotation(rotation)), rotation, atol=1e-12)
        assert quaternion_from_rotation(rotation)[0] >= 0
