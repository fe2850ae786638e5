"""Which query finds which object: against every possible assignment, with costs written out from the papers."""

import itertools
import math

import numpy as np
import pytest
import torch

from duospacenet.model.decoder import Prediction
from duospacenet.training.hungarian_matching import match_queries

NUM_CLASSES = 3
NO_NUMBER = float("nan")


def drawn(num_queries, num_objects, seed=0):
    """A prediction, pose vectors and labels of objects."""
    generator = torch.Generator().manual_seed(seed)
    prediction = Prediction(
        torch.randn(num_queries, NUM_CLASSES, generator=generator) * 2,
        torch.randn(num_queries, 10, generator=generator) * 3,
    )
    poses = torch.randn(num_objects, 10, generator=generator) * 3
    return prediction, poses, torch.randint(0, NUM_CLASSES, (num_objects,), generator=generator)


def cost(prediction, poses, labels, query, thing):
    """Twice Deformable-DETR's class cost, α = 0.25, γ = 2; a quarter of the L1 distance, x y z doubly, sizes half."""
    score = 1 / (1 + math.exp(-float(prediction.class_logits[query, labels[thing]])))
    positive = 0.25 * (1 - score) ** 2 * -math.log(score)
    negative = 0.75 * score**2 * -math.log(1 - score)
    distance = 0.0
    for k, weight in enumerate([2, 2, 2, 0.5, 0.5, 0.5]):
        distance += weight * abs(float(prediction.pose[query, k]) - float(poses[thing, k]))
    return 2 * (positive - negative) + 0.25 * distance


def total(given, pairs):
    return sum(cost(*given, query, thing) for query, thing in pairs)


def pairs_of(found):
    return list(zip(found.queries.tolist(), found.objects.tolist(), strict=True))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("num_queries", "num_objects"), [(5, 3), (4, 4), (3, 5), (6, 1)])
def test_no_assignment_of_queries_to_objects_costs_less(num_queries, num_objects, seed):
    """Also with more objects than queries: then every query has one."""
    given = drawn(num_queries, num_objects, seed)
    found = pairs_of(match_queries(*given))
    number = min(num_queries, num_objects)
    assert len({query for query, _ in found}) == len({thing for _, thing in found}) == len(found) == number
    every = (
        zip(queries, things, strict=True)
        for things in itertools.combinations(range(num_objects), number)
        for queries in itertools.permutations(range(num_queries), number)
    )
    assert total(given, found) == pytest.approx(min(total(given, pairs) for pairs in every), rel=1e-6)


def test_with_repeats_each_object_gets_as_many_queries_at_the_least_cost():
    given = drawn(6, 2)
    found = pairs_of(match_queries(*given, repeats=2))
    assert sorted(thing for _, thing in found) == [0, 0, 1, 1]
    assert len({query for query, _ in found}) == 4
    least = min(total(given, [(a, 0), (b, 0), (c, 1), (d, 1)]) for a, b, c, d in itertools.permutations(range(6), 4))
    assert total(given, found) == pytest.approx(least, rel=1e-6)


@pytest.mark.parametrize(("num_queries", "each"), [(12, 3), (11, 2), (7, 1), (4, 1)])
def test_all_objects_get_equally_many_queries_as_far_as_they_go(num_queries, each):
    found = match_queries(*drawn(num_queries, 4), repeats=3)
    assert np.bincount(found.objects, minlength=4).tolist() == [each] * 4


def test_without_objects_nothing_is_matched():
    for repeats in (1, 3):
        found = match_queries(*drawn(5, 0), repeats)
        assert (found.queries.tolist(), found.objects.tolist()) == ([], [])


def test_a_velocity_that_is_not_known_changes_no_match():
    prediction, poses, labels = drawn(6, 4)
    unknown = poses.clone()
    unknown[1:3, 8:] = NO_NUMBER
    assert pairs_of(match_queries(prediction, unknown, labels)) == pairs_of(match_queries(prediction, poses, labels))


def test_predictions_that_are_not_finite_can_be_matched_so_that_the_loss_can_tell():
    prediction, poses, labels = drawn(5, 3)
    prediction.class_logits[2] = NO_NUMBER
    prediction.pose[4] = float("inf")
    assert len(match_queries(prediction, poses, labels).queries) == 3
