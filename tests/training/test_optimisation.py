"""Tests of the optimiser and the learning-rate schedule, against rates worked by hand."""

import math
from dataclasses import replace

import pytest
from torch import nn

from duospacenet.model import DuoSpaceNet
from duospacenet.training.losses.pv_supervision import PVSupervisionHead
from duospacenet.training.optimisation import learning_rate_factor, make_optimiser, set_learning_rates
from duospacenet.training.recipe import read_recipe
from tests.helpers.trainings import TINY, settings_with

SETTINGS = settings_with(
    steps=110, warmup_steps=10, learning_rate=1.0, backbone_learning_rate=0.1, weight_decay=0.03, clip_norm=1.0
)


@pytest.fixture(scope="module")
def model():
    return DuoSpaceNet(TINY)


def mmcv_factor(step, settings):
    """The learning rate of mmcv's LrUpdaterHook as a fraction of the peak, with an annealing per iteration."""
    start, end = 1.0, settings.final_learning_rate  # min_lr_ratio
    regular = end + 0.5 * (start - end) * (math.cos(math.pi * (step / settings.steps)) + 1)
    if step >= settings.warmup_steps:
        return regular
    k = (1 - step / settings.warmup_steps) * (1 - settings.warmup_start)
    return regular * (1 - k)


@pytest.mark.parametrize("settings", [SETTINGS, replace(read_recipe("paper"), steps=4000)], ids=["short", "paper"])
def test_both_learning_rates_follow_the_schedule_of_mmcv(model, settings):
    optimiser = make_optimiser(model, nn.Module(), settings)
    for step in range(settings.steps):
        set_learning_rates(optimiser, step, settings)
        backbone, others = (group["lr"] for group in optimiser.param_groups)
        assert backbone == pytest.approx(settings.backbone_learning_rate * mmcv_factor(step, settings))
        assert others == pytest.approx(settings.learning_rate * mmcv_factor(step, settings))


@pytest.mark.parametrize(
    ("step", "factor"),
    [
        (0, 1 / 3),
        (250, 2 / 3 * (1 + math.cos(math.pi / 8)) / 2),
        (500, (1 + math.sqrt(0.5)) / 2),
        (1000, 0.5),
        (1999, 0.0),
    ],
)
def test_the_rates_of_the_papers_schedule_at_steps_worked_by_hand(step, factor):
    """2,000 steps: a warm-up of 500 from one third, and a cosine to one thousandth."""
    settings = replace(read_recipe("paper"), steps=2000)
    assert learning_rate_factor(step, settings) == pytest.approx(factor, abs=1.1e-3)
    assert learning_rate_factor(step, settings) > 1e-3


def test_without_a_warmup_the_first_step_has_the_peak_learning_rate(model):
    settings = settings_with(steps=4, warmup_steps=0, learning_rate=1.0)
    optimiser = make_optimiser(model, nn.Module(), settings)
    rates = []
    for step in range(4):
        set_learning_rates(optimiser, step, settings)
        rates.append(optimiser.param_groups[1]["lr"])
    assert rates == pytest.approx([1, (1 + math.sqrt(0.5)) / 2, 0.5, (1 - math.sqrt(0.5)) / 2])


def test_a_warmup_longer_than_the_training_ends_below_the_peak(model):
    settings = settings_with(steps=4, warmup_steps=8, warmup_start=0.0, learning_rate=1.0)
    optimiser = make_optimiser(model, nn.Module(), settings)
    set_learning_rates(optimiser, 3, settings)
    assert optimiser.param_groups[1]["lr"] == pytest.approx(3 / 8 * (1 - math.sqrt(0.5)) / 2)


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
