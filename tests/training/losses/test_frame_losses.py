"""Tests of the detection and map losses, against cases worked by hand and loops over their equations."""

import math

import numpy as np
import pytest
import torch

from duospacenet.model.decoder import Prediction
from duospacenet.training import Settings
from duospacenet.training.losses.frame_losses import (
    box_loss,
    class_loss,
    detection_losses,
    dice_loss,
    frame_weight,
    map_losses,
)
from duospacenet.training.losses.hungarian_matching import Assignment
from duospacenet.training.recipe import read_recipe
from tests.helpers.sparse4d_losses import sparse4d_losses

NAN = float("nan")
CLASSES = ("car", "traffic_cone")


def logit(score):
    return torch.tensor(math.log(score / (1 - score)), dtype=torch.float64)


def assignment_of(*pairs):
    """The assignment of these pairs (query, object)."""
    queries, objects = zip(*pairs, strict=True)
    return Assignment(torch.tensor(queries), torch.tensor(objects))


def pose_vector(**values):
    names = ["x", "y", "z", "w", "l", "h", "sin", "cos", "vx", "vy"]
    return torch.tensor([float(values.get(name, 0)) for name in names])


# --- Classes and boxes --------------------------------------------------------------------------------------------


def test_the_class_loss_is_a_sum_over_all_queries_divided_by_the_number_of_matches():
    """Two queries, two classes, all scores 0.5. Query 1 is matched to object 1 of class 0; object 0 is not matched."""
    loss = class_loss(torch.zeros(2, 2), torch.tensor([1, 0]), assignment_of((1, 1)))
    assert float(loss) == pytest.approx((0.25 + 3 * 0.75) * 0.25 * math.log(2))


def test_the_class_loss_has_one_positive_target_per_match_at_the_class_of_the_object():
    logits = torch.full((4, 3), -4.0)
    assignment = assignment_of((0, 1), (3, 0))
    labels = torch.tensor([2, 1])
    base = float(class_loss(logits, labels, assignment))
    for query in range(4):
        for label in range(3):
            raised = logits.clone()
            raised[query, label] = 2.0
            is_better = float(class_loss(raised, labels, assignment)) < base
            assert is_better == ((query, label) in [(0, 1), (3, 2)])


def test_the_box_loss_is_a_weighted_distance_divided_by_the_number_of_matches():
    pose = torch.stack([pose_vector(x=9), pose_vector(x=1, w=3, sin=1, vy=4), pose_vector(z=-1)])
    ground_truth = torch.stack([pose_vector(x=-2, h=0.5), pose_vector()])
    assignment = assignment_of((1, 0), (2, 1))  # query 0 is not matched
    assert float(box_loss(pose, ground_truth, assignment)) == pytest.approx((2 * 3 + 3 + 0.5 + 1 + 4 + 2 * 1) / 2)


def test_an_unknown_velocity_adds_no_loss_and_no_gradient():
    pose = torch.stack([pose_vector(x=1, vx=5, vy=-3)]).requires_grad_()
    loss = box_loss(pose, torch.stack([pose_vector(vx=NAN, vy=NAN)]), assignment_of((0, 0)))
    loss.backward()
    assert float(loss.detach()) == 2.0
    assert pose.grad.tolist() == [[2.0] + 9 * [0.0]]


def test_the_box_loss_is_small_across_plus_minus_180_degrees_and_large_for_opposite_headings():
    """With sine and cosine, yaws of 179.9 and -179.9 degrees differ by about 0.0035 in the sine only."""

    def loss(predicted_deg, true_deg):
        angle = math.radians(predicted_deg)
        pose = torch.stack([pose_vector(sin=math.sin(angle), cos=math.cos(angle))])
        boxes = torch.tensor([[0.0, 0, 0, 1, 1, 1, math.radians(true_deg), 0, 0]])
        prediction = Prediction(torch.zeros(1, 2), pose)
        return float(detection_losses([prediction], boxes, torch.tensor([0]), Settings(), CLASSES)["box_0"])

    assert loss(179.9, -179.9) == pytest.approx(0.25 * 2 * math.sin(math.radians(0.1)), rel=1e-3)
    assert loss(0, 180) == pytest.approx(0.25 * 2)
    assert loss(90, 180) == pytest.approx(0.25 * 2)


def test_without_objects_the_box_loss_is_zero_and_all_class_targets_are_negative():
    prediction = Prediction(torch.zeros(3, 2), torch.ones(3, 10))
    losses = detection_losses([prediction], torch.zeros(0, 9), torch.zeros(0, dtype=torch.int64), Settings(), CLASSES)
    assert float(losses["box_0"]) == 0.0
    assert float(losses["class_0"]) == pytest.approx(2 * 6 * 0.75 * 0.25 * math.log(2))


def test_every_layer_has_losses_and_all_layers_but_the_last_use_auxiliary_matches():
    """One object; every query is 1 m away in x, so the mean box loss is 2 for any number of matches."""
    boxes = torch.tensor([[1.0, 0, 0, 1, 1, 1, 0, 0, 0]])
    pose = pose_vector(cos=1).expand(4, 10)
    layers = [Prediction(torch.zeros(4, 2), pose)] * 3
    losses = detection_losses(layers, boxes, torch.tensor([0]), Settings(auxiliary_matches=3), CLASSES)
    assert list(losses) == ["class_0", "box_0", "class_1", "box_1", "class_2", "box_2"]
    for layer, matches in enumerate((3, 3, 1)):
        positive, negative = matches * 0.25, (8 - matches) * 0.75
        expected = 2 * (positive + negative) * 0.25 * math.log(2) / matches
        assert float(losses[f"class_{layer}"]) == pytest.approx(expected)
        assert float(losses[f"box_{layer}"]) == pytest.approx(0.25 * 2)


PAPER = read_recipe("paper")
WEIGHTS = Settings(class_weight=3.0, box_weight=0.5, box_loss_weights=(1, 2, 3, 4, 5, 6, 7, 8, 9, 10))


@pytest.mark.parametrize("settings", [PAPER, WEIGHTS], ids=["paper", "other weights"])
@pytest.mark.parametrize("seed", range(3))
def test_the_losses_of_a_batch_equal_those_of_sparse4d(settings, seed):
    """Four frames with 0 to 12 objects and 8 queries, about half of them with a class score below 0.05."""
    generator = torch.Generator().manual_seed(seed)
    frames = []
    for num_objects in (5, 0, 12, 3):
        boxes = torch.randn(num_objects, 9, generator=generator)
        boxes[:, 3:6] = boxes[:, 3:6].exp()
        boxes[::4, 7:] = NAN
        labels = torch.randint(2, (num_objects,), generator=generator)
        logits = 2 * torch.randn(8, 2, generator=generator) - 3.5
        frames.append((Prediction(logits, torch.randn(8, 10, generator=generator)), boxes, labels))
    expected = sparse4d_losses(frames, settings, cone=1)
    numbers = [min(8, len(boxes)) for _, boxes, _ in frames]
    weights = [frame_weight(number, sum(numbers) / 4) for number in numbers]
    losses = [detection_losses([frame[0]], *frame[1:], settings, CLASSES) for frame in frames]
    for name, value in zip(("class_0", "box_0"), expected, strict=True):
        mean = sum(weight * float(loss[name]) for weight, loss in zip(weights, losses, strict=True)) / 4
        assert mean == pytest.approx(value, rel=1e-5)
    assert expected[1] > 0


def test_a_batch_without_objects_is_divided_by_one():
    assert frame_weight(0, 0.0) == 1
    assert frame_weight(3, 0.5) == 3


def test_queries_with_a_class_score_of_at_most_the_minimum_have_no_box_loss_and_no_gradient():
    """Two objects at their queries; the score of query 0 is 0.05 for both classes, that of query 1 is 0.06 for one."""
    logits = torch.stack([logit(0.05).expand(2), torch.stack([logit(0.01), logit(0.06)])]).float()
    pose = torch.stack([pose_vector(x=1, cos=1), pose_vector(x=21, cos=1)]).requires_grad_()
    boxes = torch.tensor([[0.0, 0, 0, 1, 1, 1, 0, 0, 0], [20.0, 0, 0, 1, 1, 1, 0, 0, 0]])
    settings = Settings(box_loss_min_score=float(logits[0, 0].sigmoid()))
    loss = detection_losses([Prediction(logits, pose)], boxes, torch.tensor([0, 0]), settings, CLASSES)["box_0"]
    loss.backward()
    assert float(loss.detach()) == pytest.approx(0.25 * 2 / 2)
    assert pose.grad[0].tolist() == [0.0] * 10
    assert pose.grad[1, 0] > 0


def test_the_yaw_of_a_yaw_free_class_has_no_loss():
    pose = torch.stack([pose_vector(sin=1), pose_vector(x=20, sin=1)])
    boxes = torch.tensor([[0.0, 0, 0, 1, 1, 1, 0, 0, 0], [20.0, 0, 0, 1, 1, 1, 0, 0, 0]])
    prediction = Prediction(torch.zeros(2, 2), pose)

    def loss(*classes):
        settings = Settings(yaw_free_classes=classes)
        return float(detection_losses([prediction], boxes, torch.tensor([0, 1]), settings, CLASSES)["box_0"])

    assert loss() == pytest.approx(0.25 * 2 * (1 + 1) / 2)
    assert loss("traffic_cone") == pytest.approx(0.25 * (1 + 1) / 2)
    assert loss("traffic_cone", "car") == 0


# --- Maps ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scores", "mask", "expected"),
    [
        ([0.5, 0.5, 0.5, 0.5], [1, 1, 0, 0], 1 - (2 * 1 + 1) / (2 + 2 + 1)),
        ([0.8, 0.2, 0.2, 0.2], [1, 0, 0, 0], 1 - (2 * 0.8 + 1) / (1.4 + 1 + 1)),
        ([0.5, 0.5, 0.5, 0.5], [0, 0, 0, 0], 1 - 1 / 3),
    ],
)
def test_the_dice_loss_follows_its_equation(scores, mask, expected):
    logits = torch.stack([logit(score) for score in scores]).reshape(2, 2)
    assert float(dice_loss(logits, torch.tensor(mask).reshape(2, 2).double())) == pytest.approx(expected)


@pytest.mark.parametrize("mask", [torch.zeros(3, 3), torch.ones(3, 3), torch.eye(3)])
def test_the_dice_loss_of_a_perfect_mask_is_zero(mask):
    assert float(dice_loss((mask - 0.5) * 100, mask)) == pytest.approx(0, abs=1e-5)


def test_each_map_class_is_compared_with_its_own_mask():
    """The focal loss has α = 0.5 and 10 times the mean over the cells."""
    maps = {"a": torch.zeros(1, 1, 2, 2), "b": torch.full((1, 1, 2, 2), -60.0)}
    masks = torch.stack([torch.ones(2, 2), torch.zeros(2, 2)]).bool()
    losses = {
        name: float(loss) for name, loss in map_losses(maps, masks, torch.tensor([True, True]), Settings()).items()
    }
    assert losses.keys() == {"focal_a", "dice_a", "focal_b", "dice_b"}
    assert losses["focal_a"] == pytest.approx(10 * 0.5 * 0.25 * math.log(2))
    assert losses["dice_a"] == pytest.approx(1 - (2 * 2 + 1) / (2 + 4 + 1))
    assert np.allclose([losses["focal_b"], losses["dice_b"]], 0)


def test_a_map_class_without_a_mask_has_no_loss_and_no_gradient():
    logits = {name: torch.ones(1, 1, 2, 2, requires_grad=True) for name in "ab"}
    losses = map_losses(logits, torch.zeros(2, 2, 2, dtype=torch.bool), torch.tensor([False, True]), Settings())
    assert [losses[name].item() for name in ("focal_a", "dice_a")] == [0, 0]
    assert all(losses[name].item() > 0 for name in ("focal_b", "dice_b"))
    sum(losses.values()).backward()
    assert not logits["a"].grad.any()
    assert logits["b"].grad.all()


def test_a_model_without_maps_has_no_map_losses():
    masks, known = torch.zeros(0, 16, 16, dtype=torch.bool), torch.zeros(0, dtype=torch.bool)
    assert map_losses({}, masks, known, Settings()) == {}


def test_the_map_losses_have_the_weights_of_the_settings():
    maps, masks, known = {"a": torch.ones(1, 1, 2, 2)}, torch.eye(2)[None].bool(), torch.tensor([True])
    default = map_losses(maps, masks, known, Settings())
    changed = map_losses(maps, masks, known, Settings(map_focal_weight=5.0, map_dice_weight=3.0))
    assert float(changed["focal_a"] / default["focal_a"]) == pytest.approx(5 / 10)
    assert float(changed["dice_a"] / default["dice_a"]) == pytest.approx(3)
