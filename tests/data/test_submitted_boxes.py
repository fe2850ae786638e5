"""Boxes of a submission: their conversion to the global frame and back to numbers that an evaluation uses."""

import numpy as np
import pytest

from duospacenet.data.results import frame_result
from duospacenet.data.submitted_boxes import SubmittedBoxes
from duospacenet.runtime import Detections, Frame
from duospacenet.runtime.detections import HistoryReport
from duospacenet.runtime.geometry import (
    quaternion_from_rotation,
    rigid_transform,
    rotation_from_quaternion,
    rotation_z,
)

PITCHED_AND_ROLLED = rigid_transform(
    rotation_from_quaternion(np.array([0.8, 0.03, -0.06, 0.6]) / np.linalg.norm([0.8, 0.03, -0.06, 0.6])),
    [1130.25, -420.5, 2.5],
)


def random_detections(count: int = 40) -> Detections:
    rng = np.random.default_rng(1)
    boxes = rng.normal(size=(count, 9)) * [20, 20, 1, 1, 1, 1, 2, 4, 4]
    boxes[:, 3:6] = np.exp(boxes[:, 3:6])
    names = [str(name) for name in rng.choice(["car", "bicycle", "barrier", "bus"], count)]
    scores = np.sort(rng.random(count))[::-1]
    boxes, scores = boxes.astype(np.float32), scores.astype(np.float32)
    return Detections(boxes, scores, tuple(names), np.arange(count), HistoryReport(1), token="a")


def test_rotations_and_velocities_are_those_of_matrices():
    """A loop over the boxes: the rotation by the yaw, then that of the ego; and the velocity as a vector in 3D."""
    detections, pose = random_detections(), PITCHED_AND_ROLLED
    submitted = SubmittedBoxes.of_detections(detections, pose)
    for row, box in enumerate(detections.boxes.astype(np.float64)):
        rotation = pose[:3, :3] @ rotation_z(box[6])
        assert submitted.rotations[row] == pytest.approx(quaternion_from_rotation(rotation), abs=2e-6)
        assert submitted.centres_m[row] == pytest.approx((pose @ [*box[:3], 1])[:3], abs=2e-4)
        assert submitted.velocities_m_s[row] == pytest.approx((pose[:3, :3] @ [*box[7:9], 0])[:2], abs=2e-4)
        assert submitted.yaws_rad[row] == pytest.approx(np.arctan2(rotation[1, 0], rotation[0, 0]), abs=4e-6)
        assert submitted.sizes_wlh_m[row] == pytest.approx(box[3:6], abs=1e-4)


def test_detections_and_their_line_in_the_results_give_the_same_boxes():
    detections = random_detections()
    frame = Frame({}, {}, PITCHED_AND_ROLLED, 0.0, token="a")
    direct = SubmittedBoxes.of_detections(detections, PITCHED_AND_ROLLED)
    from_line = SubmittedBoxes.of_result(frame_result(frame, detections, {}))
    assert direct.to_json("a") == from_line.to_json("a")
    assert len(direct) == len(detections) == 40
    assert direct.attributes == detections.attributes


def test_numbers_have_few_digits():
    submitted = SubmittedBoxes.of_detections(random_detections(), PITCHED_AND_ROLLED)
    for entry in submitted.to_json("a"):
        for key, decimals in (("translation", 4), ("size", 4), ("rotation", 6), ("velocity", 4)):
            assert all(len(repr(value).partition(".")[2]) <= decimals for value in entry[key]), entry[key]
        assert len(repr(entry["detection_score"])) <= 8


def test_a_tiny_size_does_not_become_0():
    """nuscenes-devkit refuses sizes of 0."""
    box = np.array([[1, 2, 0, 1e-6, 4, 1.5, 0, 0, 0]], np.float32)
    detections = Detections(box, np.ones(1, np.float32), ("car",), np.zeros(1, np.int64), HistoryReport(1))
    assert SubmittedBoxes.of_detections(detections, np.eye(4)).sizes_wlh_m.tolist() == [[0.0001, 4, 1.5]]


def test_no_boxes_stay_no_boxes():
    frame = Frame({}, {}, np.eye(4), 0.0, token="b")
    skipped = Detections.of_skipped_frame(frame, "every camera is lost")
    for submitted in (
        SubmittedBoxes.of_detections(skipped, np.eye(4)),
        SubmittedBoxes.of_result(frame_result(frame, skipped, {})),
    ):
        assert (len(submitted), submitted.boxes.shape, submitted.to_json("b")) == (0, (0, 9), [])


def test_boxes_are_selected_by_a_mask_or_a_slice():
    submitted = SubmittedBoxes.of_detections(random_detections(4), np.eye(4))
    assert submitted[:2].to_json("a") == submitted.to_json("a")[:2]
    assert submitted[np.array([False, True, False, True])].to_json("a") == submitted.to_json("a")[1::2]
