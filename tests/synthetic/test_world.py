"""The objects of the synthetic world: how they move, and that they never overlap."""

import numpy as np
import pytest

from duospacenet.runtime.geometry import box_corners, transform
from duospacenet.synthetic.class_sizes import CLASS_SIZES_M
from duospacenet.synthetic.drive import KeyFrame, SyntheticDrive
from duospacenet.synthetic.snapshot import Snapshot
from tests.helpers.synthetic_scenes import CLASS_ORDER


@pytest.fixture(scope="module")
def drive() -> SyntheticDrive:
    return SyntheticDrive(7, frames=6)


def global_snapshot(key_frame: KeyFrame) -> Snapshot:
    """The objects of a key frame in the global frame, computed from the ego pose alone."""
    snapshot, pose = key_frame.snapshot, key_frame.global_T_ego
    boxes = snapshot.boxes.copy()
    boxes[:, :3] = transform(pose, boxes[:, :3])
    boxes[:, 7:9] = boxes[:, 7:9] @ pose[:2, :2].T
    return Snapshot(boxes, snapshot.names, snapshot.meshes, snapshot.identities)


def boxes_by_identity(drive: SyntheticDrive) -> dict:
    """Frame index -> global box, by identity, of all objects of the ten classes."""
    boxes: dict = {}
    for index in range(len(drive)):
        snapshot = global_snapshot(drive.key_frame(index))
        for i in np.flatnonzero(snapshot.is_labelled()):
            boxes.setdefault(snapshot.identities[i], {})[index] = snapshot.boxes[i]
    return boxes


@pytest.mark.parametrize("seed", range(4))
def test_velocities_are_the_change_of_positions(seed):
    drive = SyntheticDrive(seed, frames=5)
    times_s = [drive.frame_without_images(index).timestamp_s for index in range(5)]
    num_moving = 0
    for boxes in boxes_by_identity(drive).values():
        for index in range(1, 4):
            if {index - 1, index, index + 1} <= boxes.keys():
                moved = boxes[index + 1][:2] - boxes[index - 1][:2]
                measured = moved / (times_s[index + 1] - times_s[index - 1])
                assert np.allclose(boxes[index][7:9], measured, atol=0.03)
                num_moving += np.linalg.norm(measured) > 0.5
    assert num_moving > 20


def test_moving_objects_move_in_the_direction_of_their_heading(drive):
    snapshot = drive.key_frame(2).snapshot
    speed = np.linalg.norm(snapshot.boxes[:, 7:9], axis=1)
    moving = speed > 0.5
    heading = np.stack([np.cos(snapshot.boxes[:, 6]), np.sin(snapshot.boxes[:, 6])], axis=1)
    assert moving.sum() > 5
    assert np.allclose(snapshot.boxes[moving, 7:9], heading[moving] * speed[moving, None], atol=1e-6)


def test_standing_objects_keep_their_place_in_the_global_frame(drive):
    standing = [
        boxes
        for boxes in boxes_by_identity(drive).values()
        if np.allclose(next(iter(boxes.values()))[7:9], 0) and len(boxes) > 2
    ]
    assert len(standing) > 10
    for boxes in standing:
        places = np.array([box[:6] for box in boxes.values()])
        assert np.ptp(places, axis=0).max() < 1e-6


@pytest.mark.parametrize("seed", range(6))
def test_every_class_occurs_in_a_drive_and_no_frame_is_empty(seed):
    classes: set[str] = set()
    for frame in SyntheticDrive(seed, image_size=(160, 64)):
        classes |= set(frame.ground_truth.classes)
        assert 8 <= len(frame.ground_truth.boxes) <= 60
    assert tuple(CLASS_SIZES_M) == CLASS_ORDER
    assert classes == set(CLASS_ORDER)


@pytest.mark.parametrize("seed", range(12))
def test_objects_overlap_neither_each_other_nor_the_ego(seed):
    drive = SyntheticDrive(seed, frames=12)
    ego = np.array([[1.4, 0, 0.8, 1.75, 4.1, 1.6, 0, 0, 0]])
    for index in range(0, 12, 3):
        snapshot = drive.key_frame(index).snapshot
        near = snapshot.is_labelled() & (np.abs(snapshot.boxes[:, :2]) < 60).all(axis=1)
        corners = box_corners(np.concatenate([ego, snapshot.boxes[near]]))[:, :4, :2]
        for i in range(len(corners)):
            for j in range(i):
                assert are_separate(corners[i], corners[j]), (seed, index, i, j)


def are_separate(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether the line along a side of one of two rectangles (4, 2) separates them."""
    for side in (a[1] - a[0], a[2] - a[1], b[1] - b[0], b[2] - b[1]):
        if (a @ side).max() <= (b @ side).min() or (b @ side).max() <= (a @ side).min():
            return True
    return False
