"""`evaluate` as a whole: cases worked by hand, and reference values from nuscenes-devkit for the same boxes."""

import json
import time

import numpy as np
import pytest

from duospacenet.evaluation import ClassReport, EvaluationReport, Sample, evaluate
from duospacenet.evaluation.protocol import CLASSES, ERRORS
from duospacenet.runtime.errors import InputError
from tests.helpers.evaluation_samples import box, make_detections, make_ground_truth, random_sample

NAN = float("nan")

# Results of nuscenes-devkit 1.2.0 (numpy 1.26) for the 24 samples of seed 42 below. The devkit's EvalBoxes held
# DetectionBoxes with these numbers, in this order, without boxes beyond the range of their class. Detections had the
# attributes that a submission of this toolkit gives them. Then `accumulate`, `calc_ap` and `calc_tp` ran with
# `detection_cvpr_2019`, as in `DetectionEval.evaluate`, followed by `DetectionMetrics.serialize`.
# By class: AP at 0.5, 1, 2 and 4 m; ATE, ASE, AOE, AVE, AAE.
DEVKIT = {
    "car": (
        (0.033300565, 0.516199984, 0.742016999, 0.754382531),
        (0.719760192, 0.175975763, 0.33645239, 0.390158805, 0.484032849),
    ),
    "truck": (
        (0.023045761, 0.525170271, 0.677348121, 0.677348121),
        (0.62431344, 0.16445535, 0.31148201, 0.352157956, 1.0),
    ),
    "bus": (
        (0.0, 0.0, 0.0, 0.0),
        (1.0, 1.0, 1.0, 1.0, 1.0),
    ),
    "trailer": (
        (0.0, 0.0, 0.0, 0.0),
        (1.0, 1.0, 1.0, 1.0, 1.0),
    ),
    "construction_vehicle": (
        (0.0, 0.0, 0.0, 0.0),
        (1.0, 1.0, 1.0, 1.0, 1.0),
    ),
    "pedestrian": (
        (0.090707492, 0.418489074, 0.753380059, 0.753380059),
        (0.661956852, 0.197417389, 0.295098095, 0.403757377, 0.800542799),
    ),
    "motorcycle": (
        (0.014732376, 0.385075448, 0.542776734, 0.542776734),
        (0.625419298, 0.167897212, 0.373765578, 0.342810785, 0.265641172),
    ),
    "bicycle": (
        (0.0, 0.0, 0.0, 0.0),
        (1.0, 1.0, 1.0, 1.0, 1.0),
    ),
    "traffic_cone": (
        (0.044606283, 0.624342841, 0.702753179, 0.702753179),
        (0.670577805, 0.197429044, NAN, NAN, NAN),
    ),
    "barrier": (
        (0.0, 0.337123797, 0.588677055, 0.588677055),
        (0.807353475, 0.177372826, 0.351202056, NAN, NAN),
    ),
}
DEVKIT_MEANS = [
    0.275976593,
    0.292622459,
    0.810938106,
    0.508054758,
    0.629777792,
    0.686110615,
    0.818777103,
]  # mAP, NDS, mATE, mASE, mAOE, mAVE, mAAE


def one_class(name: str, *samples: Sample) -> ClassReport:
    return next(one for one in evaluate(samples).classes if one.name == name)


def sample(true_boxes: list, detected_boxes: list, scores: list, name: str = "car") -> Sample:
    return Sample(
        make_detections(detected_boxes, scores, [name] * len(detected_boxes)),
        make_ground_truth(true_boxes, [name] * len(true_boxes)),
    )


@pytest.fixture(scope="module")
def random_report() -> EvaluationReport:
    rng = np.random.default_rng(42)
    return evaluate([random_sample(rng) for _ in range(24)])


def test_all_class_metrics_equal_those_of_nuscenes_devkit(random_report):
    for one in random_report.classes:
        precisions, errors = DEVKIT[one.name]
        assert list(one.average_precisions.values()) == pytest.approx(precisions, abs=1e-8), one.name
        assert list(one.errors.values()) == pytest.approx(errors, abs=1e-8, nan_ok=True), one.name


def test_the_means_equal_those_of_nuscenes_devkit(random_report):
    report = random_report
    means = [report.mean_average_precision, report.nds, *report.mean_errors.values()]
    assert means == pytest.approx(DEVKIT_MEANS, abs=1e-8)


def test_no_samples_or_no_detections_give_the_worst_scores():
    for report in (evaluate([]), evaluate([sample([box()], [], [])])):
        assert (report.mean_average_precision, report.nds) == (0, 0)
        assert list(report.mean_errors.values()) == [1, 1, 1, 1, 1]


def test_a_class_without_ground_truth_counts_as_0_in_map():
    """One class is perfect: 1 of 10, of 9 with orientation errors, of 8 with velocity and attribute errors."""
    report = evaluate([sample([box()], [box()], [0.9])])
    assert report.mean_average_precision == pytest.approx(0.1)
    assert report.mean_errors["translation"] == pytest.approx(0.9)
    assert report.mean_errors["velocity"] == pytest.approx(7 / 8)
    assert report.nds == pytest.approx((5 / 10 + 1 / 10 + 1 / 10 + 1 / 9 + 1 / 8 + 1 / 8) / 10)


def test_perfect_detections_of_all_classes_give_an_nds_of_1():
    boxes = [box(3 * label) for label in range(len(CLASSES))]
    perfect = Sample(make_detections(boxes, np.full(len(CLASSES), 0.9), CLASSES), make_ground_truth(boxes, CLASSES))
    assert evaluate([perfect]).nds == pytest.approx(1)


def test_a_mean_error_above_1_adds_0_to_the_nds_and_is_not_subtracted():
    far_off = sample([box(v=(30, 0))], [box()], [0.9])
    report = evaluate([far_off])
    assert report.mean_errors["velocity"] > 1
    other_scores = [1 - report.mean_errors[name] for name in ERRORS if name != "velocity"]
    assert report.nds == pytest.approx((5 * report.mean_average_precision + sum(other_scores)) / 10)


@pytest.mark.parametrize(("name", "range_m"), [("car", 50), ("pedestrian", 40), ("bicycle", 40), ("barrier", 30)])
def test_boxes_beyond_the_range_of_their_class_do_not_count(name, range_m):
    """The range is a distance from the ego in x and y. At 0.6 and 0.8 of it along the axes a box is just outside."""
    inside, outside = box(0.6 * range_m - 0.01, 0.8 * range_m), box(0.6 * range_m, 0.8 * range_m)
    counted = one_class(name, sample([inside, outside], [inside, outside, outside], [0.5, 0.6, 0.7], name))
    assert (counted.num_truth, counted.num_detections) == (1, 1)
    assert counted.mean_average_precision == pytest.approx(1)


def test_a_duplicate_detection_lowers_precision():
    """Two true boxes, the first detected twice: recalls 1/2, 1/2, 1 and precisions 1, 1/2, 2/3.

    The average is derived in test_precision_curve.py.
    """
    twice = sample([box(0), box(20)], [box(0), box(0), box(20)], [0.9, 0.8, 0.7])
    assert one_class("car", twice).mean_average_precision == pytest.approx((35.1 + 51 * (7 / 12 - 0.1)) / 81)


def test_a_detection_of_another_class_does_not_match():
    mistaken = Sample(make_detections([box()], [0.9], ["truck"]), make_ground_truth([box()], ["car"]))
    assert evaluate([mistaken]).mean_average_precision == 0


def test_detections_are_ranked_over_all_samples():
    """A false positive in another sample has the higher score: recalls 0, 1 and precisions 0, 1/2.

    So precision is r / 2 at recall r. It is above 0.1 at 81 of the 90 recalls, those above 0.2, where it exceeds 0.1
    by 0.3 - 0.1 on average.
    """
    hit, miss = sample([box()], [box()], [0.5]), sample([], [box()], [0.9])
    assert one_class("car", hit, miss).average_precisions[2.0] == pytest.approx(81 * 0.2 / 90 / 0.9)


def test_the_later_of_two_equal_scores_is_ranked_first():
    """Ranked hit, then miss: precision 1, and 1/2 at the last of the 90 recalls. Otherwise as in the test above."""
    hit, miss = sample([box()], [box()], [0.5]), sample([], [box()], [0.5])
    assert one_class("car", miss, hit).mean_average_precision == pytest.approx((89 * 0.9 + 0.4) / 81)
    assert one_class("car", hit, miss).mean_average_precision == pytest.approx(81 * 0.2 / 81)


def test_true_boxes_of_other_nuscenes_categories_are_left_out_and_counted():
    report = evaluate([Sample(make_detections([], [], ()), make_ground_truth([box(), box()], ["car", "animal"]))])
    assert report.ground_truth.left_out == {("class", "animal"): 1}
    assert sum(one.num_truth for one in report.classes) == 1


def test_json_has_null_for_errors_that_a_class_does_not_have(random_report):
    read = json.loads(json.dumps(random_report.to_dict(), allow_nan=False))
    assert read["classes"]["traffic_cone"]["errors"] == {
        "translation": pytest.approx(DEVKIT["traffic_cone"][1][0]),
        "scale": pytest.approx(DEVKIT["traffic_cone"][1][1]),
        "orientation": None,
        "velocity": None,
        "attribute": None,
    }
    assert read["classes"]["car"]["AP"]["0.5"] == pytest.approx(DEVKIT["car"][0][0])
    assert read["NDS"] == random_report.nds


def infinitely_far_box() -> list:
    return [np.inf, *box()[1:]]


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (sample([], [box()] * 501, [0.5] * 501), "expected at most 500 detections"),
        (sample([], [infinitely_far_box()], [0.5]), "detections: expected finite positions"),
        (sample([infinitely_far_box()], [], []), "ground truth: expected finite positions"),
        (sample([], [box(size=(1, 0, 1))], [0.5]), "expected sizes above 0 m; got 0"),
        (sample([], [box()], [NAN]), "expected one finite score per box"),
        (
            Sample(make_detections([], [], ()), make_ground_truth([box()], ["car"], ())),
            "ground truth: expected one attribute per box, 1; got 0",
        ),
    ],
)
def test_a_sample_that_the_benchmark_does_not_accept_is_refused_with_its_number(broken, message):
    with pytest.raises(InputError, match=f"sample 1: .*{message}"):
        evaluate([sample([], [], []), broken])


def test_the_time_grows_linearly_with_the_number_of_samples():
    """100 times the samples may take 1,000 times as long. Quadratic growth would take 10,000 times as long."""
    rng = np.random.default_rng(0)
    samples = [random_sample(rng, num_true=30, num_false=30) for _ in range(40)]
    small_s = min(evaluation_time_s(samples, 40) for _ in range(3))
    assert evaluation_time_s(samples, 4000) < 1000 * small_s


def evaluation_time_s(samples: list[Sample], num_samples: int) -> float:
    """The time of an evaluation over these samples, repeated in turn."""
    start_s = time.perf_counter()
    report = evaluate(samples[number % len(samples)] for number in range(num_samples))
    assert report.num_samples == num_samples
    return time.perf_counter() - start_s
