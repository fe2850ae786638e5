"""Tests of the Hungarian matching, against all possible assignments, with costs written out from the papers."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from duospacenet.model.decoder import Prediction
from duospacenet.training import Settings
from duospacenet.training.losses.hungarian_matching import CostWeights, cost_weights, match_queries, matching_costs
from duospacenet.training.recipe import read_recipe
from tests.helpers.sparse4d_losses import sparse4d_costs

CLASSES = ("car", "truck", "traffic_cone")
NUM_CLASSES = len(CLASSES)
NAN = float("nan")
WEIGHTS = cost_weights(Settings(), CLASSES)


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
    pairs = pairs_of(match_queries(*problem, WEIGHTS))
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
    pairs = pairs_of(match_queries(*problem, WEIGHTS, repeats=2))
    assert sorted(target for _, target in pairs) == [0, 0, 1, 1]
    assert len({query for query, _ in pairs}) == 4
    assignments = ([(a, 0), (b, 0), (c, 1), (d, 1)] for a, b, c, d in itertools.permutations(range(6), 4))
    assert total_cost(problem, pairs) == pytest.approx(min(total_cost(problem, one) for one in assignments), rel=1e-6)


@pytest.mark.parametrize(("num_queries", "each"), [(12, 3), (11, 2), (7, 1), (4, 1)])
def test_all_objects_have_equally_many_queries_if_there_are_too_few_for_all_repeats(num_queries, each):
    assignment = match_queries(*random_problem(num_queries, 4), WEIGHTS, repeats=3)
    assert np.bincount(assignment.objects, minlength=4).tolist() == [each] * 4


def test_without_objects_no_query_is_matched():
    for repeats in (1, 3):
        assignment = match_queries(*random_problem(5, 0), WEIGHTS, repeats)
        assert (assignment.queries.tolist(), assignment.objects.tolist()) == ([], [])


def test_an_unknown_velocity_does_not_change_the_matching():
    prediction, poses, labels = random_problem(6, 4)
    unknown = poses.clone()
    unknown[1:3, 8:] = NAN
    known_pairs = pairs_of(match_queries(prediction, poses, labels, WEIGHTS))
    assert pairs_of(match_queries(prediction, unknown, labels, WEIGHTS)) == known_pairs


def test_predictions_that_are_not_finite_can_be_matched_so_that_the_trainer_can_report_them():
    prediction, poses, labels = random_problem(5, 3)
    prediction.class_logits[2] = NAN
    prediction.pose[4] = float("inf")
    assert len(match_queries(prediction, poses, labels, WEIGHTS).queries) == 3


OTHER_WEIGHTS = Settings(match_class_cost=1.5, match_box_cost=3.0, match_box_weights=(1, 2, 3, 4, 5, 6, 7, 8, 9, 10))


@pytest.mark.parametrize("settings", [Settings(), read_recipe("paper"), OTHER_WEIGHTS], ids=["cpu", "paper", "other"])
def test_the_costs_equal_those_of_sparse4d(settings):
    prediction, poses, labels = random_problem(6, 5)
    labels[:3] = torch.tensor([2, 2, 0])
    costs = matching_costs(prediction, poses, labels, cost_weights(settings, CLASSES))
    expected = sparse4d_costs(prediction, poses, labels, settings, cone=2)
    assert costs.numpy() == pytest.approx(np.array(expected), rel=1e-6)


def test_an_unknown_velocity_costs_nothing():
    prediction, poses, labels = random_problem(2, 1)
    poses[0, 8:] = NAN
    weights = CostWeights(0.0, 1.0, torch.tensor([[0.0] * 8 + [1.0, 1.0]]).repeat(NUM_CLASSES, 1))
    assert matching_costs(prediction, poses, labels, weights).tolist() == [[0.0], [0.0]]


def test_the_yaw_of_a_yaw_free_class_does_not_change_the_matching():
    """Two cones at the same place, with opposite yaws. Query 0 has the yaw of cone 1, but is nearer to cone 0."""
    poses = torch.zeros(2, 10)
    poses[:, 7] = torch.tensor([1.0, -1.0])
    poses[1, 0] = 0.5
    prediction = Prediction(torch.zeros(2, NUM_CLASSES), poses.clone())
    prediction.pose[:, 7] *= -1
    labels = torch.tensor([2, 2])
    paper = read_recipe("paper")
    pairs = {
        classes: pairs_of(
            match_queries(prediction, poses, labels, cost_weights(replace(paper, yaw_free_classes=classes), CLASSES))
        )
        for classes in ((), ("traffic_cone",), ("car",))
    }
    assert pairs == {(): [(0, 1), (1, 0)], ("traffic_cone",): [(0, 0), (1, 1)], ("car",): [(0, 1), (1, 0)]}
