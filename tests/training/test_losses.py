"""The losses, against cases worked by hand and loops over their equations."""

import math

import numpy as np
import pytest
import torch

from duospacenet.model.decoder import Prediction
from duospacenet.training.focal_loss import focal_loss
from duospacenet.training.hungarian_matching import Assignment
from duospacenet.training.losses import box_loss, class_loss, detection_losses, dice_loss, map_losses

NO_NUMBER = float("nan")


def logit(score):
    return torch.tensor(math.log(score / (1 - score)), dtype=torch.float64)


def pairs(*of):
    """A match of these (query, object)."""
    queries, objects = zip(*of, strict=True)
    return Assignment(torch.tensor(queries), torch.tensor(objects))


def pose_vector(**numbers):
    names = ["x", "y", "z", "w", "l", "h", "sin", "cos", "vx", "vy"]
    return torch.tensor([float(numbers.get(name, 0)) for name in names])


# --- Focal loss ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("score", "times_less"), [(0.9, 100), (0.968, 977)])
def test_what_is_classified_well_counts_as_little_as_in_the_paper(score, times_less):
    """Lin et al., 2017, section 3.2: with γ = 2, p_t = 0.9 has 100 times, p_t ≈ 0.968 about 1000 times less loss."""
    one = torch.tensor(1.0, dtype=torch.float64)
    focal, plain = (float(focal_loss(logit(score), one, alpha=1.0, gamma=gamma)) for gamma in (2.0, 0.0))
    assert plain == pytest.approx(-math.log(score))
    assert plain / focal == pytest.approx(times_less, rel=1e-3)


@pytest.mark.parametrize(
    ("score", "target", "expected"),
    [
        (0.9, 1, 0.25 * 0.01 * 0.1053605),  # α (1 - p)² · -ln p
        (0.9, 0, 0.75 * 0.81 * 2.3025851),  # (1 - α) p² · -ln (1 - p)
        (0.5, 1, 0.25 * 0.25 * 0.6931472),
        (0.5, 0, 0.75 * 0.25 * 0.6931472),
    ],
)
def test_alpha_weighs_what_is_there_against_what_is_not(score, target, expected):
    loss = focal_loss(logit(score), torch.tensor(float(target), dtype=torch.float64))
    assert float(loss) == pytest.approx(expected, rel=1e-6)


def test_the_focal_loss_of_any_logit_is_finite_and_has_a_gradient():
    logits = torch.tensor([-200.0, 200.0, -200.0, 200.0], requires_grad=True)
    loss = focal_loss(logits, torch.tensor([1.0, 0.0, 0.0, 1.0]))
    loss.sum().backward()
    assert loss.detach().numpy() == pytest.approx([50, 150, 0, 0])
    assert logits.grad.numpy() == pytest.approx([-0.25, 0.75, 0, 0], abs=1e-6)


# --- Classes and boxes --------------------------------------------------------------------------------------------


def test_the_class_loss_is_a_sum_over_all_queries_by_the_number_of_matches():
    """Two queries and classes, all scores 1/2; object 1, of class 0, belongs to query 1, and object 0 to none."""
    loss = class_loss(torch.zeros(2, 2), torch.tensor([1, 0]), pairs((1, 1)))
    assert float(loss) == pytest.approx((0.25 + 3 * 0.75) * 0.25 * math.log(2))


def test_the_class_loss_has_one_positive_target_a_match_at_its_own_class():
    logits = torch.full((4, 3), -4.0)
    found = pairs((0, 1), (3, 0))
    labels = torch.tensor([2, 1])
    base = float(class_loss(logits, labels, found))
    for query in range(4):
        for label in range(3):
            raised = logits.clone()
            raised[query, label] = 2.0
            better = float(class_loss(raised, labels, found)) < base
            assert better == ((query, label) in [(0, 1), (3, 2)])


def test_the_box_loss_is_a_weighted_distance_by_the_number_of_matches():
    pose = torch.stack([pose_vector(x=9), pose_vector(x=1, w=3, sin=1, vy=4), pose_vector(z=-1)])
    ground_truth = torch.stack([pose_vector(x=-2, h=0.5), pose_vector()])
    found = pairs((1, 0), (2, 1))  # query 0 is nobody's
    assert float(box_loss(pose, ground_truth, found)) == pytest.approx((2 * 3 + 3 + 0.5 + 1 + 4 + 2 * 1) / 2)


def test_a_velocity_that_is_not_known_costs_nothing_and_pulls_nowhere():
    pose = torch.stack([pose_vector(x=1, vx=5, vy=-3)]).requires_grad_()
    loss = box_loss(pose, torch.stack([pose_vector(vx=NO_NUMBER, vy=NO_NUMBER)]), pairs((0, 0)))
    loss.backward()
    assert float(loss.detach()) == 2.0
    assert pose.grad.tolist() == [[2.0] + 9 * [0.0]]


def test_headings_just_beside_half_a_turn_are_near_each_other_and_opposite_ones_far():
    """Through sine and cosine: yaws of 179.9 and -179.9 degrees differ by about 0.0035 in the sine alone."""

    def loss(predicted_deg, true_deg):
        angle = math.radians(predicted_deg)
        pose = torch.stack([pose_vector(sin=math.sin(angle), cos=math.cos(angle))])
        boxes = torch.tensor([[0.0, 0, 0, 1, 1, 1, math.radians(true_deg), 0, 0]])
        prediction = Prediction(torch.zeros(1, 2), pose)
        return float(detection_losses([prediction], boxes, torch.tensor([0]))["box_0"])

    assert loss(179.9, -179.9) == pytest.approx(0.25 * 2 * math.sin(math.radians(0.1)), rel=1e-3)
    assert loss(0, 180) == pytest.approx(0.25 * 2)
    assert loss(90, 180) == pytest.approx(0.25 * 2)


def test_without_objects_the_boxes_cost_nothing_and_every_score_is_too_high():
    prediction = Prediction(torch.zeros(3, 2), torch.ones(3, 10))
    losses = detection_losses([prediction], torch.zeros(0, 9), torch.zeros(0, dtype=torch.int64))
    assert float(losses["box_0"]) == 0.0
    assert float(losses["class_0"]) == pytest.approx(2 * 6 * 0.75 * 0.25 * math.log(2))


def test_every_layer_has_its_losses_and_only_those_before_the_last_repeat_their_matches():
    """One object, every query 1 m beside it in x: in the mean of matches that makes 2, however many they are."""
    boxes = torch.tensor([[1.0, 0, 0, 1, 1, 1, 0, 0, 0]])
    pose = pose_vector(cos=1).expand(4, 10)
    layers = [Prediction(torch.zeros(4, 2), pose)] * 3
    losses = detection_losses(layers, boxes, torch.tensor([0]), auxiliary_matches=3)
    assert list(losses) == ["class_0", "box_0", "class_1", "box_1", "class_2", "box_2"]
    for layer, number in enumerate((3, 3, 1)):
        positive, negative = number * 0.25, (8 - number) * 0.75
        expected = 2 * (positive + negative) * 0.25 * math.log(2) / number
        assert float(losses[f"class_{layer}"]) == pytest.approx(expected)
        assert float(losses[f"box_{layer}"]) == pytest.approx(0.25 * 2)


# --- Maps ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("scores", "mask", "expected"),
    [
        ([0.5, 0.5, 0.5, 0.5], [1, 1, 0, 0], 1 - (2 * 1 + 1) / (2 + 2 + 1)),
        ([0.8, 0.2, 0.2, 0.2], [1, 0, 0, 0], 1 - (2 * 0.8 + 1) / (1.4 + 1 + 1)),
        ([0.5, 0.5, 0.5, 0.5], [0, 0, 0, 0], 1 - 1 / 3),
    ],
)
def test_the_dice_loss_is_what_its_equation_says(scores, mask, expected):
    logits = torch.stack([logit(score) for score in scores]).reshape(2, 2)
    assert float(dice_loss(logits, torch.tensor(mask).reshape(2, 2).double())) == pytest.approx(expected)


@pytest.mark.parametrize("mask", [torch.zeros(3, 3), torch.ones(3, 3), torch.eye(3)])
def test_the_dice_loss_of_a_perfect_mask_is_nothing(mask):
    assert float(dice_loss((mask - 0.5) * 100, mask)) == pytest.approx(0, abs=1e-5)


def test_each_map_is_judged_by_its_own_mask():
    """Focal with α = 1/2, ten times its mean over the cells; each mask against logits of its own."""
    maps = {"a": torch.zeros(1, 1, 2, 2), "b": torch.full((1, 1, 2, 2), -60.0)}
    masks = torch.stack([torch.ones(2, 2), torch.zeros(2, 2)]).bool()
    losses = {name: float(loss) for name, loss in map_losses(maps, masks).items()}
    assert losses.keys() == {"focal_a", "dice_a", "focal_b", "dice_b"}
    assert losses["focal_a"] == pytest.approx(10 * 0.5 * 0.25 * math.log(2))
    assert losses["dice_a"] == pytest.approx(1 - (2 * 2 + 1) / (2 + 4 + 1))
    assert np.allclose([losses["focal_b"], losses["dice_b"]], 0)


def test_a_model_without_maps_has_no_losses_of_them():
    assert map_losses({}, torch.zeros(0, 16, 16, dtype=torch.bool)) == {}
