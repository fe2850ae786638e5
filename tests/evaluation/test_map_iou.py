"""IoU of map masks, in cases worked by hand."""

import numpy as np
import pytest

from duospacenet.evaluation import Sample, evaluate
from duospacenet.evaluation.map_iou import resample_mask
from duospacenet.runtime import Detections, Frame
from tests.helpers.evaluation_samples import make_detections, make_ground_truth


def iou(*samples: Sample) -> dict[str, float]:
    return dict(evaluate(samples).map_iou)


def sample(probabilities: list, mask: list) -> Sample:
    return Sample(
        make_detections([], [], (), road=np.array(probabilities, np.float32)),
        make_ground_truth([], (), road=np.array(mask, bool)),
    )


def test_cells_are_summed_over_all_frames_before_division():
    """1 of 3 cells and 2 of 2 cells give 3 / 5. The mean of the two frames would be 2 / 3."""
    one, other = sample([[0.9, 0.6], [0.2, 0.1]], [[1, 0], [1, 0]]), sample([[0.9, 0.9], [0, 0]], [[1, 1], [0, 0]])
    assert iou(one, other) == {"road": pytest.approx(3 / 5)}


def test_a_cell_needs_a_probability_above_one_half():
    assert iou(sample([[0.5, 0.51]], [[1, 1]])) == {"road": 0.5}


def test_a_map_without_any_cell_has_a_nan_iou_and_null_in_json():
    report = evaluate([sample([[0.1]], [[0]])])
    assert np.isnan(report.map_iou["road"])
    assert report.to_dict()["map_iou"] == {"road": None}


def test_a_map_without_ground_truth_or_without_prediction_does_not_count():
    predicted_only = Sample(make_detections([], [], (), road=np.ones((1, 1))), make_ground_truth([], ()))
    true_only = Sample(make_detections([], [], ()), make_ground_truth([], (), road=np.ones((1, 1), bool)))
    assert iou(predicted_only, true_only) == {}


def test_a_skipped_frame_counts_as_an_empty_map():
    skipped = Detections.of_skipped_frame(Frame({}, {}, np.eye(4), 0.0), "every camera is lost")
    skipped_sample = Sample(skipped, make_ground_truth([], (), road=np.array([[True, False]])))
    assert iou(sample([[0.9, 0.9]], [[1, 1]]), skipped_sample) == {"road": pytest.approx(2 / 3)}


def test_a_mask_is_resampled_at_the_centres_of_the_new_cells():
    mask = np.zeros((6, 4), bool)
    mask[4:, 1] = True
    assert resample_mask(mask, (2, 4)).astype(int).tolist() == [[0, 0, 0, 0], [0, 1, 0, 0]]
    assert resample_mask(mask, (12, 4))[8:, 1].all()
    assert not resample_mask(mask, (12, 4))[:8].any()
    assert resample_mask(mask, (6, 4)).tolist() == mask.tolist()
