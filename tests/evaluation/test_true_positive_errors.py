"""The five true positive errors of single boxes, in cases worked by hand."""

import numpy as np
import pytest

from duospacenet.evaluation.boxes import EvalBoxes
from duospacenet.evaluation.protocol import heading_period_rad
from duospacenet.evaluation.true_positive_errors import true_positive_errors
from tests.helpers.evaluation_samples import box


def errors(true: list, detected: list, name: str = "car", attribute: str | None = None) -> dict[str, float]:
    """The errors of one detection. attribute: that of the true box; None derives it from class and speed."""
    ground_truth = EvalBoxes.of_sample(
        0, np.array([true], float), np.zeros(1), [name], None if attribute is None else [attribute]
    )
    detections = EvalBoxes.of_sample(0, np.array([detected], np.float32), np.ones(1), [name])
    by_name = true_positive_errors(ground_truth, detections, heading_period_rad(name))
    return {error: float(values[0]) for error, values in by_name.items()}


def test_translation_is_measured_in_x_and_y_only():
    higher = box(13, 4)
    higher[2] = 7.0
    assert errors(box(10, 0), higher)["translation"] == pytest.approx(5)


def test_scale_is_1_minus_the_iou_of_the_aligned_boxes():
    """2x4x1.5 and 4x2x1.5: the intersection is 2x2x1.5 = 6, the union 12 + 12 - 6."""
    assert errors(box(size=(2, 4, 1.5)), box(size=(4, 2, 1.5)))["scale"] == pytest.approx(1 - 6 / 18)


@pytest.mark.parametrize(
    ("name", "true_rad", "detected_rad", "expected"),
    [
        ("car", 0.1, -0.2, 0.3),
        ("car", 3.0, -3.0, 2 * np.pi - 6),
        ("car", 0.0, np.pi, np.pi),
        ("barrier", 0.0, np.pi - 0.2, 0.2),
        ("barrier", 0.1, np.pi / 2 + 0.1, np.pi / 2),
        ("car", 0.0, 9 * np.pi + 0.1, np.pi - 0.1),
    ],
)
def test_orientation_is_the_smaller_angle_and_a_barrier_has_a_period_of_pi(name, true_rad, detected_rad, expected):
    assert errors(box(yaw=true_rad), box(yaw=detected_rad), name)["orientation"] == pytest.approx(expected, abs=1e-5)


def test_velocity_is_the_norm_of_the_difference_and_nan_if_the_true_velocity_is_unknown():
    assert errors(box(v=(1, 2)), box(v=(4, -2)))["velocity"] == pytest.approx(5)
    assert np.isnan(errors(box(v=(np.nan, np.nan)), box(v=(4, -2)))["velocity"])


@pytest.mark.parametrize(
    ("true_attribute", "speed", "expected"),
    [
        ("vehicle.parked", 0.0, 0.0),
        ("vehicle.parked", 1.0, 1.0),
        ("vehicle.stopped", 0.0, 1.0),
        ("vehicle.moving", 1.0, 0.0),
    ],
)
def test_the_attribute_error_is_0_or_1(true_attribute, speed, expected):
    assert errors(box(), box(v=(speed, 0)), "car", true_attribute)["attribute"] == expected


def test_a_true_attribute_that_no_detection_can_have_is_an_error():
    assert errors(box(), box(), "pedestrian", "pedestrian.sitting_lying_down")["attribute"] == 1


def test_a_true_box_without_attribute_has_no_attribute_error():
    assert np.isnan(errors(box(), box(), "car", "")["attribute"])
    assert np.isnan(errors(box(), box(), "barrier")["attribute"])


@pytest.mark.parametrize(("speed", "expected"), [(0.1, 1.0), (3.0, 0.0), (np.nan, np.nan)])
def test_missing_true_attributes_are_derived_from_the_speed(speed, expected):
    error = errors(box(v=(speed, 0)), box(v=(2, 0)), "bus")["attribute"]
    assert error == pytest.approx(expected, nan_ok=True)
