"""The five true positive errors of single boxes, worked out by hand."""

import numpy as np
import pytest

from duospacenet.evaluation.boxes import EvalBoxes
from duospacenet.evaluation.protocol import heading_period_rad
from duospacenet.evaluation.true_positive_errors import true_positive_errors
from tests.helpers.evaluation_samples import box


def errors(true: list, detected: list, name: str = "car", attribute: str | None = None) -> dict[str, float]:
    """The errors of one detection. attribute: the truth's; by the rule where None."""
    ground_truth = EvalBoxes.of(0, np.array([true], float), np.zeros(1), [name], None if attribute is None else [attribute])
    found = EvalBoxes.of(0, np.array([detected], np.float32), np.ones(1), [name])
    off = true_positive_errors(ground_truth, found, heading_period_rad(name))
    return {error: float(values[0]) for error, values in off.items()}


def test_translation_is_measured_on_the_ground():
    higher = box(13, 4)
    higher[2] = 7.0
    assert errors(box(10, 0), higher)["translation"] == pytest.approx(5)


def test_scale_is_what_two_aligned_boxes_do_not_share():
    """2x4x1.5 and 4x2x1.5 share 2x2x1.5 = 6 of 12 + 12 - 6."""
    assert errors(box(size=(2, 4, 1.5)), box(size=(4, 2, 1.5)))["scale"] == pytest.approx(1 - 6 / 18)


@pytest.mark.parametrize(
    ("name", "true", "found", "expected"),
    [
        ("car", 0.1, -0.2, 0.3),
        ("car", 3.0, -3.0, 2 * np.pi - 6),
        ("car", 0.0, np.pi, np.pi),
        ("barrier", 0.0, np.pi - 0.2, 0.2),
        ("barrier", 0.1, np.pi / 2 + 0.1, np.pi / 2),
        ("car", 0.0, 9 * np.pi + 0.1, np.pi - 0.1),
    ],
)
def test_orientation_is_the_smaller_turn_and_a_barrier_looks_the_same_from_behind(name, true, found, expected):
    assert errors(box(yaw=true), box(yaw=found), name)["orientation"] == pytest.approx(expected, abs=1e-5)


def test_velocity_is_the_length_of_the_difference_and_unknown_where_the_truth_is():
    assert errors(box(v=(1, 2)), box(v=(4, -2)))["velocity"] == pytest.approx(5)
    assert np.isnan(errors(box(v=(np.nan, np.nan)), box(v=(4, -2)))["velocity"])


@pytest.mark.parametrize(
    ("true", "speed", "expected"),
    [
        ("vehicle.parked", 0.0, 0.0),
        ("vehicle.parked", 1.0, 1.0),
        ("vehicle.stopped", 0.0, 1.0),
        ("vehicle.moving", 1.0, 0.0),
    ],
)
def test_an_attribute_is_right_or_wrong(true, speed, expected):
    assert errors(box(), box(v=(speed, 0)), "car", true)["attribute"] == expected


def test_an_attribute_that_no_detection_is_ever_given_is_wrong():
    assert errors(box(), box(), "pedestrian", "pedestrian.sitting_lying_down")["attribute"] == 1


def test_a_truth_without_attribute_has_no_attribute_error():
    assert np.isnan(errors(box(), box(), "car", "")["attribute"])
    assert np.isnan(errors(box(), box(), "barrier")["attribute"])


@pytest.mark.parametrize(("speed", "expected"), [(0.1, 1.0), (3.0, 0.0), (np.nan, np.nan)])
def test_true_attributes_that_are_not_named_follow_from_the_speed(speed, expected):
    error = errors(box(v=(speed, 0)), box(v=(2, 0)), "bus")["attribute"]
    assert error == pytest.approx(expected, nan_ok=True)
