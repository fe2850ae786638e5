"""IoU of map masks, in cases worked by hand."""

from dataclasses import replace

import numpy as np
import pytest

from duospacenet.evaluation import Sample, evaluate
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


def test_a_true_mask_of_another_grid_is_compared_on_the_predicted_grid():
    """Two predicted cells; the mask has four. The centres of the new cells are in the second and the fourth one."""
    predicted = sample([[0.9], [0.9]], [[0], [1], [0], [0]])
    assert iou(predicted) == {"road": 0.5}


def test_frames_are_counted_for_each_map_class():
    report = evaluate(
        [sample([[0.1]], [[0]]), sample([[0.1]], [[0]]), Sample(make_detections([], [], ()), make_ground_truth([], ()))]
    )
    assert report.num_map_samples == {"road": 2}
    assert report.num_samples == 3


def test_a_frame_with_a_mask_only_says_nothing_about_boxes():
    """Its detection would be a false positive if its true boxes were known to be none."""
    car = [10.0, 0, 0, 2, 4, 1.5, 0, 0, 0]
    alone = Sample(
        make_detections([car], [0.9], ("car",), road=np.ones((1, 1), np.float32)),
        replace(make_ground_truth([], (), road=np.ones((1, 1), bool)), has_boxes=False),
    )
    report = evaluate([alone])
    assert report.map_iou == {"road": 1.0}
    assert (report.num_samples, report.has_boxes) == (0, False)
    assert {key: report.to_dict()[key] for key in ("mAP", "NDS", "classes")} == {
        "mAP": None,
        "NDS": None,
        "classes": {},
    }
    assert set(report.to_dict()["errors"].values()) == {None}
    found = Sample(make_detections([car], [0.5], ("car",)), make_ground_truth([car], ("car",)))
    both = evaluate([alone, found])
    assert both.classes[0].num_detections == both.classes[0].num_truth == both.num_samples == 1
    assert both.classes[0].mean_average_precision == pytest.approx(1.0)
