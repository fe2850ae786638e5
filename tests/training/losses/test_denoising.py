"""Tests of the denoising queries: their poses, their content and their losses."""

import math

import pytest
import torch

from duospacenet.model.decoder import Prediction
from duospacenet.training import Settings
from duospacenet.training.losses.denoising import NOISE, denoising_losses, denoising_queries, shuffle_boxes

BOXES = torch.tensor(
    [[10.0, -3, 1, 2, 4, 1.5, 0.5, 5, 1], [-20, 8, 0.5, 0.6, 0.7, 1.8, -2.0, math.nan, math.nan]] * 500
)


def queries_near(boxes=BOXES, seed=0, num_queries=40):
    """Content and poses of denoising queries. The content of model query i is (3i, 3i + 1, 3i + 2)."""
    content = torch.arange(num_queries * 3.0).reshape(num_queries, 3)
    return denoising_queries(content, boxes, torch.Generator().manual_seed(seed))


def test_poses_are_spread_around_the_ground_truth_within_the_maximum_noise():
    """The pose vector is position, log size, sine and cosine of the yaw, and velocity (0 if unknown)."""
    _, pose = queries_near()
    for i, box in enumerate(BOXES.tolist()[:2]):
        x, y, z, w, l, h, yaw, vx, vy = box  # noqa: E741
        ground_truth = [x, y, z, math.log(w), math.log(l), math.log(h), math.sin(yaw), math.cos(yaw), vx, vy]
        ground_truth = torch.tensor([0.0 if math.isnan(value) else value for value in ground_truth])
        noise = (pose[i::2] - ground_truth) / torch.tensor(NOISE)
        assert noise.abs().max() <= 1 + 1e-4
        assert (noise.amax(dim=0) > 0.95).all()
        assert (noise.amin(dim=0) < -0.95).all()
        assert (noise.mean(dim=0).abs() < 0.1).all()


def test_the_content_is_sampled_from_each_part_of_the_model_queries_in_turn():
    """With 1000 boxes and 40 model queries, each model query is used 25 times, in order. With two boxes, the first one
    uses a query of the first half.
    """
    content, _ = queries_near()
    assert (content[:, 0] / 3).long().tolist() == [i // 25 for i in range(1000)]
    for seed in range(20):
        first, second = (queries_near(BOXES[:2], seed)[0][:, 0] / 3).tolist()
        assert 0 <= first < 20 <= second < 40


def test_boxes_are_shuffled_and_repeated_once_for_unshared_queries():
    boxes = torch.arange(45.0).reshape(5, 9)
    orders = [shuffle_boxes(boxes, torch.Generator().manual_seed(seed), False)[:, 0].tolist() for seed in range(20)]
    assert all(sorted(order) == boxes[:, 0].tolist() for order in orders)
    assert len({order[0] for order in orders}) == 5
    twice = shuffle_boxes(boxes, torch.Generator().manual_seed(0), True)
    assert twice[:5].tolist() == twice[5:].tolist()
    assert twice[:5, 0].tolist() == orders[0]


def test_the_content_gets_a_gradient_and_the_noise_depends_on_the_generator_only():
    content = torch.randn(7, 3, requires_grad=True)
    denoising_queries(content, BOXES[:7], torch.Generator().manual_seed(0))[0].sum().backward()
    assert torch.equal(content.grad, torch.ones(7, 3))
    assert torch.equal(queries_near(seed=1)[1], queries_near(seed=1)[1])
    assert not torch.equal(queries_near(seed=1)[1], queries_near(seed=2)[1])


def test_the_denoising_loss_of_a_layer_is_the_mean_distance_of_its_poses_from_their_boxes():
    """0.25 · weighted L1 per query, with weights (2, 2, 2, 1, ...). An unknown velocity adds nothing."""
    pose = torch.zeros(2, 10)
    predictions = [Prediction(torch.zeros(2, 1), pose), Prediction(torch.zeros(2, 1), pose + 1)]
    total = [0.0, 0.0]
    for x, y, z, w, l, h, yaw, vx, vy in BOXES[:2].tolist():  # noqa: E741
        ground_truth = [x, y, z, math.log(w), math.log(l), math.log(h), math.sin(yaw), math.cos(yaw), vx, vy]
        for layer in range(2):
            for weight, value in zip((2, 2, 2, 1, 1, 1, 1, 1, 1, 1), ground_truth, strict=True):
                total[layer] += 0.0 if math.isnan(value) else weight * abs(layer - value)
    losses = denoising_losses(predictions, BOXES[:2], Settings())
    assert losses.keys() == {"denoised_0", "denoised_1"}
    assert [float(loss) for loss in losses.values()] == pytest.approx([0.25 * one / 2 for one in total], rel=1e-5)


def test_the_denoising_losses_have_the_weights_of_the_settings():
    predictions = [Prediction(torch.zeros(1, 1), torch.zeros(1, 10))]
    box = torch.tensor([[3.0, 0, 0, 1, 1, 1, 0, 0, 0]])  # cos = 1
    settings = Settings(box_weight=2.0, box_loss_weights=(5, 0, 0, 0, 0, 0, 0, 7, 0, 0))
    assert float(denoising_losses(predictions, box, settings)["denoised_0"]) == 2 * (5 * 3 + 7 * 1)
