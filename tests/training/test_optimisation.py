"""Tests of the optimiser and the learning-rate schedule, against rates worked by hand."""

import math

import pytest
from torch import nn

from duospacenet.model import DuoSpaceNet
from duospacenet.training.optimisation import make_optimiser, set_learning_rates
from duospacenet.training.pv_supervision import PVSupervisionHead
from tests.helpers.trainings import TINY, settings_with

SETTINGS = settings_with(
    steps=110, warmup_steps=10, learning_rate=1.0, backbone_learning_rate=0.1, weight_decay=0.03, clip_norm=1.0
)


@pytest.fixture(scope="module")
def model():
    return DuoSpaceNet(TINY)


@pytest.mark.parametrize(
    ("step", "factor"),
    [
        (0, 0.1),
        (4, 0.5),
        (9, 1.0),
        (10, 1.0),  # the cosine starts here and takes 100 steps
        (35, (1 + math.sqrt(0.5)) / 2),
        (60, 0.5),
        (109, (1 - math.cos(math.pi / 100)) / 2),
    ],
)
def test_both_learning_rates_have_a_linear_warmup_to_their_peak_and_then_a_cosine(model, step, factor):
    optimiser = make_optimiser(model, nn.Module(), SETTINGS)
    set_learning_rates(optimiser, step, SETTINGS)
    assert [group["lr"] for group in optimiser.param_groups] == pytest.approx([0.1 * factor, factor])


def test_without_a_warmup_the_first_step_has_the_peak_learning_rate(model):
    settings = settings_with(steps=4, warmup_steps=0, learning_rate=1.0)
    optimiser = make_optimiser(model, nn.Module(), settings)
    rates = []
    for step in range(4):
        set_learning_rates(optimiser, step, settings)
        rates.append(optimiser.param_groups[1]["lr"])
    assert rates == pytest.approx([1, (1 + math.sqrt(0.5)) / 2, 0.5, (1 - math.sqrt(0.5)) / 2])


def test_a_warmup_longer_than_the_training_ends_below_the_peak(model):
    settings = settings_with(steps=4, warmup_steps=8, learning_rate=1.0)
    optimiser = make_optimiser(model, nn.Module(), settings)
    set_learning_rates(optimiser, 3, settings)
    assert optimiser.param_groups[1]["lr"] == pytest.approx(0.5)


@pytest.mark.parametrize("with_head", [True, False])
def test_every_parameter_is_in_one_group_and_the_first_group_is_the_backbone(model, with_head):
    head = PVSupervisionHead(TINY) if with_head else nn.Module()
    backbone, others = (group["params"] for group in make_optimiser(model, head, SETTINGS).param_groups)
    names = {id(tensor): name for name, tensor in model.named_parameters()}
    names |= {id(tensor): f"head.{name}" for name, tensor in head.named_parameters()} if head else {}
    assert sorted(names) == sorted(map(id, [*backbone, *others]))
    assert len(backbone) > 10
    assert all(names[id(tensor)].startswith("image_encoder.backbone.") for tensor in backbone)
    assert not any(names[id(tensor)].startswith("image_encoder.backbone.") for tensor in others)


def test_the_optimiser_is_adamw_with_the_weight_decay_of_the_settings(model):
    optimiser = make_optimiser(model, nn.Module(), SETTINGS)
    assert type(optimiser).__name__ == "AdamW"
    assert [group["weight_decay"] for group in optimiser.param_groups] == [0.03, 0.03]
