"""True boxes in the global frame are those of the annotations that they were read from."""

import numpy as np

from duospacenet.data.global_boxes import to_global
from duospacenet.data.nuscenes.annotated_boxes import boxes_in_ego
from duospacenet.runtime.geometry import rigid_transform, rotation_from_quaternion, rotation_z


def test_a_quarter_turn_is_worked_by_hand():
    """The ego at (100, 50, 2) heads along global y, so its (x, y) is (-y, x) in the global frame."""
    box = [10, -4, 0.5, 2, 4, 1.5, np.pi / 2, 3, -1]
    pose = rigid_transform(rotation_z(np.pi / 2), [100, 50, 2])
    np.testing.assert_allclose(to_global(np.array([box]), pose), [[104, 60, 2.5, 2, 4, 1.5, np.pi, 1, 3]], atol=1e-12)


def test_boxes_of_a_pitched_and_rolled_ego_return_to_their_annotations():
    """The centres return bit by bit, because annotations have few decimals."""
    rng = np.random.default_rng(0)
    quaternion = np.array([0.7, 0.05, -0.04, 0.7])
    rotation = rotation_from_quaternion(quaternion / np.linalg.norm(quaternion))
    pose = rigid_transform(rotation, [411.3039349319818, 1180.8903791765097, 0.0])
    centres = np.round(pose[:3, 3] + rng.normal(size=(50, 3)) * [30, 30, 1], 3)
    yaws, velocities, sizes = rng.uniform(-3, 3, 50), rng.normal(size=(50, 2)), rng.uniform(1, 3, (50, 3))
    velocities[3] = np.nan
    rotations = np.array([rotation_z(yaw) for yaw in yaws])
    boxes = boxes_in_ego(centres, sizes, rotations, velocities, np.repeat(pose[None], 50, axis=0))
    found = to_global(boxes, pose)
    np.testing.assert_array_equal(found[:, :3], centres)
    np.testing.assert_allclose(found[:, 3:], np.column_stack([sizes, yaws, velocities]), atol=1e-12)
    assert np.abs(boxes[:, 6] - yaws).max() > 0.01  # the case is not trivial
