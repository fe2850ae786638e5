"""Tests of the training frames."""

from dataclasses import replace

import numpy as np

from duospacenet.training.training_frames import make_training_frame
from duospacenet.weights.input_contract import preprocessing
from tests.helpers.trainings import TINY, synthetic_frames


def test_a_training_frame_keeps_its_time_and_its_pose_in_double_precision():
    (frame,) = synthetic_frames(1, 1)
    late = replace(frame, timestamp_s=1.5e9 + 1e-6)
    training_frame = make_training_frame(late, TINY, preprocessing(TINY))
    assert float(training_frame.timestamp_s) == 1.5e9 + 1e-6
    np.testing.assert_allclose(training_frame.global_T_ego.numpy(), frame.global_T_ego, atol=1e-12)
