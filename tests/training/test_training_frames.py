"""Tests of the training frames."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.runtime.errors import InputError
from duospacenet.training.training_frames import make_training_frame
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.trainings import TINY, synthetic_frames


def test_a_training_frame_keeps_its_time_and_its_pose_in_double_precision():
    (frame,) = synthetic_frames(1, 1)
    late = replace(frame, timestamp_s=1.5e9 + 1e-6)
    training_frame = make_training_frame(late, TINY, preprocessing(TINY))
    assert float(training_frame.timestamp_s) == 1.5e9 + 1e-6
    np.testing.assert_allclose(training_frame.global_T_ego.numpy(), frame.global_T_ego, atol=1e-12)


def test_a_training_frame_has_the_boxes_of_the_models_classes_within_the_grid():
    """The grid of tiny reaches to 51.2 m. Names of nuScenes' categories are mapped."""
    (frame,) = synthetic_frames(1, 1)
    names = ("vehicle.car", "animal", "car", "bus", "pedestrian")
    boxes = np.ones((5, 9))
    boxes[:, 0] = [1, 2, 51.3, 51.1, 5]
    truth = replace(frame.ground_truth, boxes=boxes, classes=names, num_points=np.array([1, 1, 1, -1, 0]))
    training_frame = make_training_frame(replace(frame, ground_truth=truth), TINY, preprocessing(TINY))
    np.testing.assert_allclose(training_frame.boxes[:, 0], [1, 51.1], rtol=1e-6)
    assert [TINY.classes[label] for label in training_frame.labels] == ["car", "bus"]


def test_unknown_class_names_are_refused_with_the_token_of_the_frame():
    (frame,) = synthetic_frames(1, 1)
    truth = replace(frame.ground_truth, boxes=np.ones((1, 9)), classes=("Car",))
    with pytest.raises(InputError, match=rf"^frame {frame.token}: ground truth: expected .*; got 'Car' \(1 box\)"):
        make_training_frame(replace(frame, ground_truth=truth), TINY, preprocessing(TINY))
