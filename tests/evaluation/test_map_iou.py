"""IoU of map masks, worked out by hand."""

import numpy as np
import pytest

from duospacenet.evaluation import Sample, evaluate
from duospacenet.evaluation.map_iou import resample_mask
from duospacenet.runtime import Detections, Frame
from tests.helpers.evaluation_samples import found, true


def iou(*samples: Sample) -> dict[str, float]:
    return dict(evaluate(samples).map_iou)


def sample(probabilities: list, mask: list) -> Sample:
    return Sample(found([], [], (), road=np.array(probabilities, np.float32)), true([], (), road=np.array(mask, bool)))


def test_cells_are_summed_over_all_frames_before_they_are_divided():
    """1 of 3 cells, and 2 of 2: 3 of 5, where the mean of the frames would be 2/3."""
    one, other = sample([[0.9, 0.6], [0.2, 0.1]], [[1, 0], [1, 0]]), sample([[0.9, 0.9], [0, 0]], [[1, 1], [0, 0]])
    assert iou(one, other) == {"road": pytest.approx(3 / 5)}


def test_a_probability_of_a_half_is_not_enough():
    assert iou(sample([[0.5, 0.51]], [[1, 1]])) == {"road": 0.5}


def test_a_map_that_is_nowhere_has_no_iou_and_null_in_json():
    report = evaluate([sample([[0.1]], [[0]])])
    assert np.isnan(report.map_iou["road"])
    assert report.to_dict()["map_iou"] == {"road": None}


def test_a_map_that_is_not_known_or_not_drawn_does_not_count():
    drawn = Sample(found([], [], (), road=np.ones((1, 1))), true([], ()))
    known = Sample(found([], [], ()), true([], (), road=np.ones((1, 1), bool)))
    assert iou(drawn, known) == {}


def test_a_frame_that_was_skipped_misses_its_map():
    skipped = Detections.of_skipped_frame(Frame({}, {}, np.eye(4), 0.0), "every camera is lost")
    missed = Sample(skipped, true([], (), road=np.array([[True, False]])))
    assert iou(sample([[0.9, 0.9]], [[1, 1]]), missed) == {"road": pytest.approx(2 / 3)}


def test_a_mask_on_another_grid_is_read_at_the_centres_of_the_cells():
    mask = np.zeros((6, 4), bool)
    mask[4:, 1] = True
    assert resample_mask(mask, (2, 4)).astype(int).tolist() == [[0, 0, 0, 0], [0, 1, 0, 0]]
    assert resample_mask(mask, (12, 4))[8:, 1].all()
    assert not resample_mask(mask, (12, 4))[:8].any()
    assert resample_mask(mask, (6, 4)).tolist() == mask.tolist()
