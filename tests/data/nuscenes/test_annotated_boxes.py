"""Velocities and boxes, against values worked out by hand and a loop over single boxes."""

import numpy as np
import pytest

from duospacenet.data.nuscenes.annotated_boxes import box_velocities, boxes_in_ego
from duospacenet.data.nuscenes.poses import rigid_transforms
from duospacenet.runtime.geometry import rotation_z, transform

NONE = -1


@pytest.mark.parametrize(
    ("times_s", "expected"),
    [
        # Centres at x = 0, 3 and 9 m. Each case: the times of three key frames, and vx in each of them.
        ((0, 0.5, 1.0), (6, 9, 12)),
        ((0, 1.5, 3.0), (2, 3, 4)),  # at the limits of 1.5 s and 3 s
        ((0, 1.6, 2.1), (np.nan, 9 / 2.1, 12)),
        ((0, 1.6, 3.1), (np.nan, np.nan, 4)),
        ((0, 0, 1.0), (np.nan, 9, 6)),
    ],
)
def test_a_velocity_is_the_difference_of_the_neighbours_within_a_time_limit(times_s, expected):
    centres = np.array([[0.0, 5, 0], [3, 5, 1], [9, 5, 2]])
    velocities = box_velocities(centres, np.array(times_s, float), np.array([NONE, 0, 1]), np.array([1, 2, NONE]))
    np.testing.assert_allclose(velocities[:, 0], expected)
    np.testing.assert_array_equal(velocities[:, 1], np.where(np.isnan(expected), np.nan, 0))


def test_the_velocity_of_an_object_that_is_annotated_once_is_unknown():
    velocity = box_velocities(np.ones((1, 3)), np.ones(1), np.array([NONE]), np.array([NONE]))
    assert np.isnan(velocity).all()


def test_a_pitched_and_rolled_ego_gives_the_annotated_headings_and_velocities_back():
    rng = np.random.default_rng(1)
    tilted = np.concatenate([rng.normal(1, 0.1, (8, 1)), rng.normal(0, 0.05, (8, 2)), rng.normal(0, 2, (8, 1))], axis=1)
    global_T_ego = rigid_transforms(rng.normal(0, 1000, (8, 3)), tilted)
    centres, yaws, velocities = rng.normal(0, 1000, (8, 3)), rng.uniform(-3, 3, 8), rng.normal(0, 9, (8, 2))
    rotations = np.array([rotation_z(yaw) for yaw in yaws])
    boxes = boxes_in_ego(centres, np.ones((8, 3)), rotations, velocities, global_T_ego)
    for box, centre, yaw, velocity, pose in zip(boxes, centres, yaws, velocities, global_T_ego, strict=True):
        np.testing.assert_allclose(transform(pose, box[:3]), centre, atol=1e-9)
        # As in a submission: the rotation and the velocity of the box, turned into the global frame.
        np.testing.assert_allclose((pose[:3, :3] @ [*box[7:], 0])[:2], velocity, atol=1e-12)
        heading = (pose[:3, :3] @ rotation_z(box[6]))[:2, 0]
        np.testing.assert_allclose(np.arctan2(heading[1], heading[0]), yaw, atol=1e-12)
