"""Tests of Sparse4D's anchors: conventions by hand, and files that are refused."""

import math

import numpy as np
import pytest
import torch

from duospacenet.weights import CheckpointError
from duospacenet.weights.sparse4d_anchors import read_sparse4d_anchors, to_pose_vectors

NUM_ANCHORS = 4
TILT = 0.03  # rad; the lidar is tilted by about a degree


def anchor(x=0.0, y=0.0, z=0.0, length=1.0, width=1.0, height=1.0, yaw=0.0, velocity=(0.0, 0.0, 0.0)):
    """An anchor of Sparse4D: sizes along the heading, to the left and up; the yaw from the lidar's x axis."""
    return [x, y, z, math.log(length), math.log(width), math.log(height), math.sin(yaw), math.cos(yaw), *velocity]


def pose_of(**values):
    (pose,) = to_pose_vectors(np.array([anchor(**values)]))
    return pose


def anchors_of(count=NUM_ANCHORS):
    return np.array([anchor(x=float(i), y=20.0, length=4.5, width=2.0, height=1.7) for i in range(count)])


# --- Conventions ----------------------------------------------------------------------------------------------------


def test_the_lidar_is_94_cm_before_the_ego_origin_and_184_cm_above_it():
    np.testing.assert_allclose(pose_of()[:3], [0.943713, 0.0, 1.84023])


def test_the_lidars_y_axis_points_forward_and_its_x_axis_to_the_right():
    """20 m before the lidar, and 10 m to its right."""
    np.testing.assert_allclose(pose_of(y=20.0)[:3], [20.943713, 0.0, 1.84023], atol=20 * TILT)
    np.testing.assert_allclose(pose_of(x=10.0)[:3], [0.943713, -10.0, 1.84023], atol=10 * TILT)


def test_the_first_size_is_the_length_and_becomes_the_second():
    np.testing.assert_allclose(np.exp(pose_of(length=4.5, width=2.0, height=1.7)[3:6]), [2.0, 4.5, 1.7])


@pytest.mark.parametrize(
    ("yaw", "expected"),
    [(math.pi / 2, 0.0), (0.0, -math.pi / 2), (math.pi, math.pi / 2), (3 * math.pi / 4, math.pi / 4)],
)
def test_the_yaw_is_counted_from_the_egos_x_axis(yaw, expected):
    """A car that drives forward has a yaw of 90 degrees in the lidar frame, and of 0 in the ego frame."""
    pose = pose_of(yaw=yaw)
    assert math.atan2(pose[6], pose[7]) == pytest.approx(expected, abs=TILT)
    assert math.hypot(pose[6], pose[7]) == pytest.approx(1, abs=1e-3)


def test_velocities_are_rotated_and_not_moved():
    np.testing.assert_allclose(pose_of(velocity=(0.0, 10.0, 0.0))[8:], [10.0, 0.0], atol=10 * TILT)
    np.testing.assert_allclose(pose_of(velocity=(3.0, 0.0, 0.0))[8:], [0.0, -3.0], atol=3 * TILT)


def test_the_transform_is_the_rotation_by_the_quaternion_and_the_translation():
    """q p q*, written out for the calibration of LIDAR_TOP in scene-0061."""
    w, x, y, z = 0.7077955119163518, -0.006492242056004365, 0.010646214713995808, -0.7063073142877817
    point, axis = np.array([3.0, -7.0, 0.5]), np.array([x, y, z])
    rotated = point + 2 * w * np.cross(axis, point) + 2 * np.cross(axis, np.cross(axis, point))
    moved = rotated + np.array([0.943713, 0.0, 1.84023])
    np.testing.assert_allclose(pose_of(x=3.0, y=-7.0, z=0.5)[:3], moved, atol=1e-6)


# --- Files ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wrapped", [lambda tensors: tensors, lambda tensors: {"state_dict": tensors, "meta": {}}])
@pytest.mark.parametrize("prefix", ["head.", "", "module.pts_bbox_head."])
def test_a_checkpoint_and_an_array_give_the_same_pose_vectors(tmp_path, wrapped, prefix):
    anchors = anchors_of()
    np.save(tmp_path / "nuscenes_kmeans900.npy", anchors)
    others = {"head.fc.weight": torch.zeros(3), "map_head.instance_bank.anchor": torch.zeros(100, 40)}
    name = f"{prefix}instance_bank.anchor"
    torch.save(wrapped({name: torch.from_numpy(anchors).float(), **others}), tmp_path / "sparse4d.pth")
    from_array, from_checkpoint = (
        read_sparse4d_anchors(tmp_path / file, NUM_ANCHORS) for file in ("nuscenes_kmeans900.npy", "sparse4d.pth")
    )
    assert from_array.shape == (NUM_ANCHORS, 10)
    assert from_array.dtype == torch.float32
    torch.testing.assert_close(from_array, torch.from_numpy(to_pose_vectors(anchors)).float())
    torch.testing.assert_close(from_checkpoint, from_array, atol=1e-5, rtol=1e-5)


def assert_refused(path, *words):
    with pytest.raises(CheckpointError) as refusal:
        read_sparse4d_anchors(path, NUM_ANCHORS)
    for word in (path.name, *words):
        assert word in str(refusal.value)


@pytest.mark.parametrize("shape", [(3, 11), (5, 11), (4, 10), (44,), (4, 11, 1), (0, 11)])
def test_an_array_of_another_shape_is_refused(tmp_path, shape):
    np.save(tmp_path / "anchors.npy", np.zeros(shape))
    assert_refused(tmp_path / "anchors.npy", "shape (4, 11)", "duospacenet anchors --queries 4")


@pytest.mark.parametrize(
    ("column", "value", "word"),
    [(0, math.nan, "finite"), (9, math.inf, "finite"), (3, 9.0, "logarithms"), (7, 0.0, "sin and cos")],
)
def test_impossible_numbers_are_refused(tmp_path, column, value, word):
    anchors = anchors_of()
    anchors[2, column] = value
    np.save(tmp_path / "anchors.npy", anchors)
    assert_refused(tmp_path / "anchors.npy", word)


def test_files_without_such_anchors_are_refused(tmp_path):
    array = tmp_path / "anchors.npy"
    np.save(array, anchors_of())
    array.write_bytes(array.read_bytes()[:-50])
    assert_refused(array, "cannot be read")
    np.save(array, np.array([{}]), allow_pickle=True)
    assert_refused(array, "cannot be read")
    np.save(array, np.array([["a"] * 11] * 4))
    assert_refused(array, "array of numbers")
    checkpoint = tmp_path / "other.pth"
    torch.save({"head.fc.weight": torch.zeros(3), "map.instance_bank.anchor": torch.zeros(100, 40)}, checkpoint)
    assert_refused(checkpoint, "instance_bank.anchor", "got none")
    two = {f"{name}.instance_bank.anchor": torch.zeros(4, 11) for name in ("a", "b")}
    torch.save(two, checkpoint)
    assert_refused(checkpoint, "a.instance_bank.anchor, b.instance_bank.anchor")
    checkpoint.write_text("not a checkpoint")
    assert_refused(checkpoint)
