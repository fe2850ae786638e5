"""Tests of the training frames."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.runtime.errors import InputError
from duospacenet.training.samples.training_frames import make_training_frame
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


def frame_with_maps(**maps):
    (frame,) = synthetic_frames(1, 1)
    return replace(frame, ground_truth=replace(frame.ground_truth, maps=maps))


def test_masks_of_another_grid_are_resampled_at_the_centres_of_the_models_cells():
    """The grid of tiny has 16 x 16 cells. The centres of rows 0 to 4 are in row 0 of 3, those of 5 to 10 in row 1.

    Row 5 begins at 5/16 of the range and row 1 of the mask at 1/3; the centre of row 5 is at 5.5/16 = 0.344. In y, the
    mask is four times as fine: the centre of column j is the border of its columns 4 j + 1 and 4 j + 2.
    """
    mask = np.zeros((3, 64), bool)
    mask[1, 4 * 7 + 2] = True
    mask[1, 4 * 9 + 1] = True  # no cell's value
    frame = make_training_frame(frame_with_maps(drivable_area=mask, lane_boundary=mask), TINY, preprocessing(TINY))
    expected = np.zeros((16, 16), bool)
    expected[5:11, 7] = True
    for values in frame.maps.numpy():
        np.testing.assert_array_equal(values, expected)
    assert frame.map_known.tolist() == [True, True]


def test_a_map_class_without_a_mask_is_unknown():
    names = list(TINY.map_classes)
    frame = make_training_frame(frame_with_maps(**{names[1]: np.ones((16, 16), bool)}), TINY, preprocessing(TINY))
    assert frame.map_known.tolist() == [False, True]
    assert not frame.maps[0].any()
    assert frame.maps[1].all()
