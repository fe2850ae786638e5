"""Tests of the Hungarian matching, against all possible assignments, with costs written out from the papers."""

import itertools
import math

import numpy as np
import pytest
import torch

from duospacenet.model.decoder import Prediction
from duospacenet.training.hungarian_matching import match_queries

NUM_CLASSES = 3
NAN = float("nan")


def random_problem(num_queries, num_objects, seed=0):
    """A random prediction, and pose vectors and labels of objects."""
    generator = torch.Generator().manual_seed(seed)
    prediction = Prediction(
        torch.randn(num_queries, NUM_CLASSES, generator=generator) * 2,
        torch.randn(num_queries, 10, generator=generator) * 3,
    )
    poses = torch.randn(num_objects, 10, generator=generator) * 3
    return prediction, poses, torch.randint(0, NUM_CLASSES, (num_objects,), generator=generator)


def cost(prediction, poses, labels, query, target):
    """2 · the class cost of Deformable-DETR (α = 0.25, γ = 2) + 0.25 · L1, with weights 2 for x y z, 0.5 for sizes."""
    score = 1 / (1 + math.exp(-float(prediction.class_logits[query, labels[target]])))
    positive = 0.25 * (1 - score) ** 2 * -math.log(score)
    negative = 0.75 * score**2 * -math.log(1 - score)
    distance = 0.0
    for k, weight in enumerate([2, 2, 2, 0.5, 0.5, 0.5]):
        distance += weight * abs(float(prediction.pose[query, k]) - float(poses[target, k]))
    return 2 * (positive - negative) + 0.25 * distance


def total_cost(problem, pairs):
    return sum(cost(*problem, query, target) for query, target in pairs)


def pairs_of(assignment):
    return list(zip(assignment.queries.tolist(), assignment.objects.tolist(), strict=True))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("num_queries", "num_objects"), [(5, 3), (4, 4), (3, 5), (6, 1)])
def test_no_other_assignment_costs_less(num_queries, num_objects, seed):
    """With more objects than queries, every query has one object."""
    problem = random_problem(num_queries, num_objects, seed)
    pairs = pairs_of(match_queries(*problem))
    count = min(num_queries, num_objects)
    assert len({query for query, _ in pairs}) == len({target for _, target in pairs}) == len(pairs) == count
    assignments = (
        zip(queries, targets, strict=True)
        for targets in itertools.combinations(range(num_objects), count)
        for queries in itertools.permutations(range(num_queries), count)
    )
    least = min(total_cost(problem, assignment) for assignment in assignments)
    assert total_cost(problem, pairs) == pytest.approx(least, rel=1e-6)


def test_with_repeats_each_object_has_several_queries_at_the_least_cost():
    problem = random_problem(6, 2)
    pairs = pairs_of(match_queries(*problem, repeats=2))
    assert sorted(target for _, target in pairs) == [0, 0, 1, 1]
    assert len({query for query, _ in pairs}) == 4
    assignments = ([(a, 0), (b, 0), (c, 1), (d, 1)] for a, b, c, d in itertools.permutations(range(6), 4))
    assert total_cost(problem, pairs) == pytest.approx(min(total_cost(problem, one) for one in assignments), rel=1e-6)


@pytest.mark.parametrize(("num_queries", "each"), [(12, 3), (11, 2), (7, 1), (4, 1)])
def test_all_objects_have_equally_many_queries_if_there_are_too_few_for_all_repeats(num_queries, each):
    assignment = match_queries(*random_problem(num_queries, 4), repeats=3)
    assert np.bincount(assignment.objects, minlength=4).tolist() == [each] * 4


def test_without_objects_no_query_is_matched():
    for repeats in (1, 3):
        assignment = match_queries(*random_problem(5, 0), repeats)
        assert (assignment.queries.tolist(), assignment.objects.tolist()) == ([], [])


def test_an_unknown_velocity_does_not_change_the_matching():
    prediction, poses, labels = random_problem(6, 4)
    unknown = poses.clone()
    unknown[1:3, 8:] = NAN
    assert pairs_of(match_queries(prediction, unknown, labels)) == pairs_of(match_queries(prediction, poses, labels))


def test_predictions_that_are_not_finite_can_be_matched_so_that_the_trainer_can_report_them():
    prediction, poses, labels = random_problem(5, 3)
    prediction.class_logits[2] = NAN
    prediction.pose[4] = float("inf")
    assert len(match_queries(prediction, poses, labels).queries) == 3
