import math
import warnings

import numpy as np
import pytest

from duospacenet.runtime import Frame
from duospacenet.runtime.detections import MAX_DETECTIONS, Detections, HistoryReport, select_detections, sigmoid


def logits_from(probabilities):
    probabilities = np.array(probabilities)
    return np.log(probabilities / (1 - probabilities)).astype(np.float32)


def boxes_for(logits):
    return np.arange(9 * len(logits), dtype=np.float32).reshape(-1, 9)


def test_pairs_of_query_and_class_are_sorted_by_score():
    logits = logits_from([[0.2, 0.9], [0.6, 0.1], [0.3, 0.7]])
    queries, labels, scores, dropped = select_detections(logits, boxes_for(logits))
    assert list(zip(queries, labels, strict=True)) == [(0, 1), (2, 1), (1, 0), (2, 0), (0, 0), (1, 1)]
    np.testing.assert_allclose(scores, [0.9, 0.7, 0.6, 0.3, 0.2, 0.1], rtol=1e-6)
    assert (scores.dtype, dropped) == (np.float32, 0)


def test_one_query_can_give_several_detections_and_another_one_none():
    logits = np.full((400, 10), -9.0, np.float32)
    logits[7] = np.arange(10)
    queries, labels, _, _ = select_detections(logits, boxes_for(logits))
    assert queries[:10].tolist() == [7] * 10
    assert labels[:10].tolist() == [9, 8, 7, 6, 5, 4, 3, 2, 1, 0]


def test_only_the_500_highest_scores_are_kept():
    logits = np.random.default_rng(0).normal(size=(900, 10)).astype(np.float32)
    queries, labels, scores, _ = select_detections(logits, boxes_for(logits))
    pairs = [(1 / (1 + math.exp(-logits[q, c])), q, c) for q in range(900) for c in range(10)]
    best = sorted(pairs, reverse=True)[:MAX_DETECTIONS]
    assert len(scores) == MAX_DETECTIONS == 500
    np.testing.assert_allclose(scores, [score for score, _, _ in best], rtol=1e-6)
    assert set(zip(queries.tolist(), labels.tolist(), strict=True)) == {(q, c) for _, q, c in best}


def test_equal_scores_keep_the_order_of_queries_and_classes():
    logits = np.zeros((3, 2), np.float32)
    queries, labels, _, _ = select_detections(logits, boxes_for(logits))
    assert list(zip(queries, labels, strict=True)) == [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1)]


def test_many_equal_scores_keep_the_order_of_queries_and_classes():
    """Numpy sorts a few numbers stably with any algorithm, so this needs many: 9000 pairs with 3 different scores."""
    logits = np.random.default_rng(0).integers(-1, 2, (900, 10)).astype(np.float32)
    queries, labels, _, _ = select_detections(logits, boxes_for(logits))
    pairs = sorted((-logits[q, c], q, c) for q in range(900) for c in range(10))
    assert list(zip(queries.tolist(), labels.tolist(), strict=True)) == [(q, c) for _, q, c in pairs[:MAX_DETECTIONS]]


@pytest.mark.parametrize("num_higher", [0, 1, 499, 500])
def test_equal_scores_at_the_limit_of_500_keep_the_order_of_queries_and_classes(num_higher):
    """The pairs with the higher score are the last ones of the array."""
    logits = np.zeros((900, 10), np.float32)
    logits.ravel()[9000 - num_higher :] = 1
    queries, labels, _, _ = select_detections(logits, boxes_for(logits))
    expected = [*range(9000 - num_higher, 9000), *range(500 - num_higher)]
    assert (10 * queries + labels).tolist() == expected


@pytest.mark.parametrize("num_queries", [49, 50, 51])
def test_all_pairs_are_kept_up_to_the_limit_of_500(num_queries):
    logits = np.random.default_rng(0).normal(size=(num_queries, 10)).astype(np.float32)
    queries, labels, _, _ = select_detections(logits, boxes_for(logits))
    pairs = sorted((-logits[q, c], q, c) for q in range(num_queries) for c in range(10))
    assert list(zip(queries.tolist(), labels.tolist(), strict=True)) == [(q, c) for _, q, c in pairs[:500]]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_query_with_a_number_that_is_not_finite_is_dropped_as_a_whole(bad):
    logits = logits_from([[0.2, 0.9], [0.6, 0.1], [0.3, 0.7]])
    boxes = boxes_for(logits)
    logits[0, 0], boxes[2, 8] = bad, bad
    queries, labels, scores, dropped = select_detections(logits, boxes)
    assert list(zip(queries, labels, strict=True)) == [(1, 0), (1, 1)]
    np.testing.assert_allclose(scores, [0.6, 0.1], rtol=1e-6)
    assert dropped == 2


def test_dropped_queries_do_not_count_towards_the_limit_of_500():
    logits = np.random.default_rng(0).normal(size=(80, 10)).astype(np.float32)
    logits[:25] = np.nan
    queries, _, scores, dropped = select_detections(logits, boxes_for(logits))
    assert (len(scores), dropped) == (500, 25)
    assert queries.min() == 25


def test_no_finite_query_gives_no_detections():
    queries, labels, scores, dropped = select_detections(
        np.full((5, 2), np.nan, np.float32), np.zeros((5, 9), np.float32)
    )
    assert (len(queries), len(labels), len(scores), dropped) == (0, 0, 0, 5)


def test_the_sigmoid_is_accurate_for_all_logits_and_gives_no_warning():
    logits = np.array([-1e30, -200, -50, -3.5, -0.0, 0.0, 3.5, 50, 200, 1e30, -np.inf, np.inf], np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        values = sigmoid(logits)
    expected = [0, 0, math.exp(-50), 1 / (1 + math.exp(3.5)), 0.5, 0.5, 1 / (1 + math.exp(-3.5)), 1, 1, 1, 0, 1]
    np.testing.assert_allclose(values, expected, rtol=1e-6)
    assert values.dtype == np.float32


def test_detections_are_degraded_if_a_query_was_dropped():
    empty = {"boxes": np.zeros((0, 9)), "scores": np.zeros(0), "classes": (), "queries": np.zeros(0, int)}
    assert not Detections(**empty, history=HistoryReport(1)).degraded
    assert Detections(**empty, history=HistoryReport(1), dropped_queries=1).degraded


def test_a_skipped_frame_has_an_empty_result_with_its_name_and_reason():
    frame = Frame({}, {}, np.eye(4), np.float32(2.5), "scene", "token")
    result = Detections.of_skipped_frame(frame, "lost cameras: front")
    assert (result.boxes.shape, result.boxes.dtype) == ((0, 9), np.float32)
    assert (result.scores.shape, result.scores.dtype) == ((0,), np.float32)
    assert (result.queries.shape, result.queries.dtype) == ((0,), np.int64)
    assert (len(result), result.classes, dict(result.maps), dict(result.timings_s)) == (0, (), {}, {})
    assert result.history == HistoryReport(0, None)
    assert not result.degraded
    assert (result.scene, result.token, result.skipped) == ("scene", "token", "lost cameras: front")
    assert (result.timestamp_s, type(result.timestamp_s)) == (2.5, float)


def test_a_result_is_degraded_if_map_cells_were_dropped_and_has_a_length():
    boxes, scores = np.zeros((2, 9), np.float32), np.ones(2, np.float32)
    result = Detections(boxes, scores, ("car", "bus"), np.arange(2), HistoryReport(1), dropped_map_cells=1)
    assert result.degraded
    assert len(result) == 2
    assert (result.timestamp_s, result.dropped_queries) == (0.0, 0)


def test_attributes_follow_from_class_and_speed_unless_they_are_given():
    boxes = np.zeros((3, 9), np.float32)
    boxes[1, 7:9] = 3, 4
    facts = boxes, np.ones(3, np.float32), ("car", "pedestrian", "barrier"), np.arange(3), HistoryReport(1)
    assert Detections(*facts).attributes == ("vehicle.parked", "pedestrian.moving", "")
    given = ("vehicle.stopped", "pedestrian.sitting_lying_down", "")
    assert Detections(*facts, attributes=given).attributes == given
    assert Detections.of_skipped_frame(Frame({}, {}, np.eye(4), 0.0), "no image").attributes == ()
