"""Transforms of poses, against those of single ones."""

import numpy as np

from duospacenet.data.nuscenes.poses import rigid_transforms, rotations_from_quaternions
from duospacenet.runtime.geometry import rotation_from_quaternion


def test_rotations_equal_those_of_single_quaternions():
    quaternions = np.random.default_rng(0).normal(size=(4, 5, 4))
    rotations = rotations_from_quaternions(quaternions)
    for index in np.ndindex(4, 5):
        unit = quaternions[index] / np.linalg.norm(quaternions[index])
        np.testing.assert_allclose(rotations[index], rotation_from_quaternion(unit), atol=1e-12)


def test_a_transform_turns_first_and_then_moves():
    # A quarter turn to the left about z, and a quaternion that is twice as long as needed.
    pose = rigid_transforms(np.array([10.0, 20, 30]), np.array([np.sqrt(2), 0, 0, np.sqrt(2)]))
    np.testing.assert_allclose(pose @ [1, 2, 3, 1], [8, 21, 33, 1], atol=1e-12)
