"""Denoising queries: where they begin, whose content they have, and what they are judged by."""

import math

import pytest
import torch

from duospacenet.model.decoder import Prediction
from duospacenet.training.denoising import NOISE, denoising_losses, denoising_queries, shuffle_boxes

BOXES = torch.tensor(
    [[10.0, -3, 1, 2, 4, 1.5, 0.5, 5, 1], [-20, 8, 0.5, 0.6, 0.7, 1.8, -2.0, math.nan, math.nan]] * 500
)


def begun(seed=0, boxes=BOXES, num_queries=40):
    content = torch.arange(num_queries * 3.0).reshape(num_queries, 3)
    return denoising_queries(content, boxes, torch.Generator().manual_seed(seed))


def test_poses_begin_around_the_truth_and_nowhere_further_than_the_noise():
    """The pose vector written out: position, log size, sine and cosine of the yaw, velocity; 0 where it is unknown."""
    _, pose = begun()
    for i, box in enumerate(BOXES.tolist()[:2]):
        x, y, z, w, l, h, yaw, vx, vy = box  # noqa: E741
        ground_truth = [x, y, z, math.log(w), math.log(l), math.log(h), math.sin(yaw), math.cos(yaw), vx, vy]
        ground_truth = torch.tensor([0.0 if math.isnan(value) else value for value in ground_truth])
        away = (pose[i::2] - ground_truth) / torch.tensor(NOISE)
        assert away.abs().max() <= 1 + 1e-4
        assert (away.amax(dim=0) > 0.95).all()
        assert (away.amin(dim=0) < -0.95).all()
        assert (away.mean(dim=0).abs() < 0.1).all()


def test_content_is_the_models_own_from_each_share_in_turn():
    """A thousand objects, forty queries: each has 25 of them, in order; of two, one is in the first half."""
    content, _ = begun()
    assert (content[:, 0] / 3).long().tolist() == [i // 25 for i in range(1000)]
    for seed in range(20):
        first, second = (begun(seed, BOXES[:2])[0][:, 0] / 3).tolist()
        assert 0 <= first < 20 <= second < 40


def test_boxes_are_begun_beside_in_any_order_and_where_spaces_have_their_own_queries_in_both_halves():
    boxes = torch.arange(45.0).reshape(5, 9)
    orders = [shuffle_boxes(boxes, torch.Generator().manual_seed(seed), False)[:, 0].tolist() for seed in range(20)]
    assert all(sorted(order) == boxes[:, 0].tolist() for order in orders)
    assert len({order[0] for order in orders}) == 5
    twice = shuffle_boxes(boxes, torch.Generator().manual_seed(0), True)
    assert twice[:5].tolist() == twice[5:].tolist()
    assert twice[:5, 0].tolist() == orders[0]


def test_gradients_reach_the_content_and_noise_hangs_on_the_generator_alone():
    content = torch.randn(7, 3, requires_grad=True)
    denoising_queries(content, BOXES[:7], torch.Generator().manual_seed(0))[0].sum().backward()
    assert torch.equal(content.grad, torch.ones(7, 3))
    assert torch.equal(begun(1)[1], begun(1)[1])
    assert not torch.equal(begun(1)[1], begun(2)[1])


def test_each_layer_is_judged_by_how_far_its_poses_are_from_their_own_objects():
    """Weights (2, 2, 2, 1, ...), by a quarter, a query; a velocity that is not known counts nothing."""
    pose = torch.zeros(2, 10)
    predictions = [Prediction(torch.zeros(2, 1), pose), Prediction(torch.zeros(2, 1), pose + 1)]
    total = [0.0, 0.0]
    for x, y, z, w, l, h, yaw, vx, vy in BOXES[:2].tolist():  # noqa: E741
        ground_truth = [x, y, z, math.log(w), math.log(l), math.log(h), math.sin(yaw), math.cos(yaw), vx, vy]
        for layer in range(2):
            for weight, value in zip((2, 2, 2, 1, 1, 1, 1, 1, 1, 1), ground_truth, strict=True):
                total[layer] += 0.0 if math.isnan(value) else weight * abs(layer - value)
    losses = denoising_losses(predictions, BOXES[:2])
    assert losses.keys() == {"denoised_0", "denoised_1"}
    assert [float(loss) for loss in losses.values()] == pytest.approx([0.25 * one / 2 for one in total], rel=1e-5)
