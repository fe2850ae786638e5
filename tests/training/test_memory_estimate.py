"""Tests of the memory estimate against the allocations of a real training step, as torch's profiler counts them."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import pytest
import torch
from torch.profiler import ProfilerActivity, profile

from duospacenet.model import DuoSpaceNet
from duospacenet.training.activation_checkpointing import checkpoint_activations
from duospacenet.training.memory_estimate import MemoryEstimate, estimate_memory
from tests.helpers.trainings import TINY, new_trainer, settings_with, synthetic_training_frames

CONFIG = replace(TINY, num_frames=2, num_layers=1)  # fewer operators, which take most of the time
TOLERANCE = 0.15
PAPER = {
    "history": "windows",
    "frozen_stages": 1,
    "backbone_norm_eval": True,
    "denoising": 0,
    "pv_supervision": False,
    "bev_supervision": False,
}
CASES = {
    "the default": ({}, False),
    "checkpointing": ({}, True),
    "the paper's settings": (PAPER, True),
    "bfloat16": ({"amp": "bfloat16"}, False),
    "maps alone": ({"tasks": "maps"}, False),
}

estimated = cache(estimate_memory)


def peak_of_allocations(function: Callable[[], object]) -> int:
    """The largest total size [bytes] of the memory that is allocated while `function` runs, and not yet freed."""
    with profile(activities=[ProfilerActivity.CPU], profile_memory=True) as profiler:
        function()
    assert profiler.profiler is not None
    events = [event for event in profiler.profiler.kineto_results.events() if event.name() == "[memory]"]
    now = peak = 0
    for event in sorted(events, key=lambda event: event.start_ns()):
        now += event.nbytes()
        peak = max(peak, now)
    return peak


def measured_step(settings, checkpointing):
    """The peak of the second step, which has a past frame, and for which the optimiser has its state."""
    trainer = new_trainer(settings, CONFIG)
    if checkpointing:
        checkpoint_activations(trainer.model)
    clip = synthetic_training_frames(1, 2, CONFIG)
    steps = (step for _ in range(2) for step in trainer.train_on([clip]))
    next(steps)
    trainer.optimiser.zero_grad()  # so that the step frees nothing that was allocated before it
    return peak_of_allocations(lambda: next(steps))


@pytest.mark.parametrize("case", CASES)
def test_the_activations_are_those_of_a_real_step(case):
    changes, checkpointing = CASES[case]
    settings = settings_with(**changes)
    estimate = estimated(CONFIG, settings, checkpointing=checkpointing)
    assert estimate.activations == pytest.approx(measured_step(settings, checkpointing), rel=TOLERANCE)


def test_weights_gradients_and_moments_are_counted_from_the_parameters():
    """4 bytes per number. AdamW has two moments. Frozen parameters have no gradient."""
    settings = settings_with(ema_decay=0.99, backbone_norm_eval=True, pv_supervision=False, bev_supervision=False)
    estimate = estimate_memory(CONFIG, settings)
    model = DuoSpaceNet(CONFIG)
    norms = [m for m in model.image_encoder.backbone.modules() if isinstance(m, torch.nn.BatchNorm2d)]
    frozen = sum(2 * norm.num_features for norm in norms)
    num_parameters = sum(parameter.numel() for parameter in model.parameters())
    num_buffers = sum(buffer.numel() for buffer in model.buffers())
    assert estimate.gradients == 4 * (num_parameters - frozen)
    assert estimate.optimiser == 2 * estimate.gradients
    assert 4 * num_parameters < estimate.weights <= 4 * num_parameters + 8 * num_buffers
    assert estimate.average == estimate.weights


def test_past_frames_are_the_features_of_the_window_without_its_newest_frame():
    """Four PV levels of six cameras at strides 8, 16, 32 and 64, and BEV features of 16x16 cells, in float32."""
    pixels = 20 * 8 + 10 * 4 + 5 * 2 + 3 * 1
    assert estimated(CONFIG, settings_with()).past_frames == 4 * 32 * (6 * pixels + 16 * 16)


def test_memory_grows_with_the_frames_and_weights_do_not():
    one, four = (estimated(CONFIG, settings_with(), **frames) for frames in ({}, {"frames": 4}))
    assert (four.activations, four.past_frames) == (4 * one.activations, 4 * one.past_frames)
    assert (four.weights, four.gradients, four.optimiser) == (one.weights, one.gradients, one.optimiser)


def test_a_stream_keeps_the_past_frames_of_all_parts_of_a_step_and_windows_those_of_one():
    for history, factor in {"stream": 3, "windows": 1}.items():
        settings = settings_with(history=history)
        one, three = (estimated(CONFIG, settings, accumulation_steps=parts) for parts in (1, 3))
        assert three == one._replace(past_frames=factor * one.past_frames)


@pytest.mark.parametrize("settings", [{"tasks": "maps"}, {"pretraining": True}, {"past_frames": 0}])
def test_past_frames_take_no_memory_where_the_decoder_does_not_use_them(settings):
    assert estimated(CONFIG, settings_with(**settings)).past_frames == 0


def test_the_estimate_is_one_line_with_its_parts():
    estimate = MemoryEstimate(0.32e9, 0.25e9, 0.5e9, 0, 0.61e9, 9.84e9)
    assert str(estimate) == ("about 11.5 GB (weights 0.3, gradients 0.2, AdamW 0.5, past frames 0.6, activations 9.8)")


def test_the_random_numbers_of_the_training_do_not_change():
    before = torch.get_rng_state()
    estimate_memory(CONFIG, settings_with(tasks="maps", past_frames=0))
    assert torch.equal(torch.get_rng_state(), before)
