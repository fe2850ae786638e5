"""The gate: half a point of each metric, and 99 % of mAP."""

import pytest

from duospacenet.jobs.quantization_gate import losses, violations
from duospacenet.runtime.bundle.quantization_record import MetricsRecord


def metrics(mAP: float = 0.8, NDS: float = 0.7, **map_iou: float) -> MetricsRecord:
    return MetricsRecord(mAP=mAP, NDS=NDS, map_iou=map_iou)


FLOAT32 = metrics(road=0.9, lanes=0.7)


def test_the_same_metrics_and_better_ones_pass():
    assert violations(FLOAT32, FLOAT32) == {}
    assert violations(FLOAT32, metrics(0.9, 0.8, road=0.95, lanes=0.75)) == {}


def test_a_loss_of_less_than_half_a_point_passes():
    assert violations(FLOAT32, metrics(0.7951, 0.6951, road=0.8951, lanes=0.6951)) == {}


@pytest.mark.parametrize(
    ("int8", "message"),
    [
        (metrics(0.7949, 0.7, road=0.9, lanes=0.7), "mAP: expected a loss of at most 0.005; got 0.0051"),
        (metrics(0.8, 0.6949, road=0.9, lanes=0.7), "NDS: expected a loss of at most 0.005; got 0.0051"),
        (metrics(0.8, 0.7, road=0.9, lanes=0.69), "IoU of lanes: expected a loss of at most 0.005; got 0.0100"),
    ],
)
def test_a_larger_loss_of_any_metric_is_named(int8, message):
    assert list(violations(FLOAT32, int8).values()) == [message]


def test_one_per_cent_of_a_small_map_is_less_than_half_a_point():
    """The rule of MLPerf Automotive: 99 % of mAP."""
    assert violations(metrics(0.2), metrics(0.1981)) == {}
    assert violations(metrics(0.2), metrics(0.1979)) == {"mAP": "mAP: expected at least 99% of 0.2000; got 0.1979"}


def test_losses_are_differences():
    assert losses(FLOAT32, metrics(0.79, 0.71, road=0.9, lanes=0.7)) == pytest.approx(
        {"mAP": 0.01, "NDS": -0.01, "IoU of road": 0.0, "IoU of lanes": 0.0}
    )
