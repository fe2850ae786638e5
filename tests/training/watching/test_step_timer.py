"""Tests of the step timer and of the reports that it makes, with a clock that the test moves."""

from types import SimpleNamespace

import pytest
import torch

from duospacenet.training.trainer import TrainingStep
from duospacenet.training.watching import step_timer
from duospacenet.training.watching.step_report import NOT_LOSSES
from duospacenet.training.watching.step_timer import StepTimer
from tests.helpers.training_logs import MEASURED


class Clock:
    def __init__(self):
        self.now_s = 1000.0

    def advance(self, seconds, result=None):
        self.now_s += seconds
        return result


@pytest.fixture
def clock(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(step_timer.time, "monotonic", lambda: clock.now_s)
    return clock


def trainer_of(num_steps):
    groups = [{"lr": 1e-5}, {"lr": 1e-4}]
    optimiser, settings = SimpleNamespace(param_groups=groups), SimpleNamespace(steps=num_steps)
    return SimpleNamespace(optimiser=optimiser, settings=settings, device=torch.device("cpu"))


def step_of(number, num_frames=2, gradient_norm=3.0):
    return TrainingStep(number, {"box_0": 1.0, "total": 2.5}, gradient_norm, num_frames)


def test_waiting_and_training_are_measured_per_step(clock):
    """The first load starts the workers: 60 s that count nowhere. Then 1 s of training, and 3 s with 2 s of waiting."""
    timer = StepTimer(trainer_of(10), steps_per_epoch=4)
    assert timer.wait(lambda: clock.advance(60, "batch")) == "batch"
    clock.advance(1)
    first = timer.report(step_of(0, num_frames=2))
    assert (first.step_s, first.waiting_s, first.waiting_share) == pytest.approx((1, 0, 0))
    assert (first.frames_per_s, first.remaining_s, first.epoch) == pytest.approx((2, 9, 0.25))
    timer.wait(lambda: clock.advance(2))
    clock.advance(1)
    second = timer.report(step_of(1, num_frames=4))
    assert (second.step_s, second.waiting_s, second.recent_step_s) == pytest.approx((3, 2, 2))
    assert second.waiting_share == pytest.approx(2 / 4)
    assert second.frames_per_s == pytest.approx(6 / 4)
    assert second.remaining_s == pytest.approx(8 * 2)


def test_checkpoints_and_validations_are_not_part_of_a_step(clock):
    timer = StepTimer(trainer_of(10), None)
    timer.wait(lambda: None)
    clock.advance(1)
    timer.report(step_of(0))
    timer.pause(lambda: clock.advance(100))
    clock.advance(2)
    report = timer.report(step_of(1))
    assert (report.step_s, report.remaining_s) == pytest.approx((2, 8 * 1.5))
    assert report.epoch is None


def test_rates_follow_the_newest_hundred_steps(clock):
    timer = StepTimer(trainer_of(1000), None)
    timer.wait(lambda: None)
    for number in range(300):
        clock.advance(10 if number < 200 else 0.5)
        report = timer.report(step_of(number))
    assert report.frames_per_s == pytest.approx(4)
    assert report.remaining_s == pytest.approx(700 * 0.5)


def test_a_report_is_a_line_of_the_log(clock):
    timer = StepTimer(trainer_of(4), 2)
    timer.wait(lambda: None)
    clock.advance(0.5)
    line = timer.report(step_of(1)).to_dict()
    assert {name: line[name] for name in line.keys() - MEASURED} == {
        "step": 1,
        "epoch": 1.0,
        "learning_rate": 1e-4,
        "backbone_learning_rate": 1e-5,
        "gradient_norm": 3.0,
        "box_0": 1.0,
        "total": 2.5,
    }
    assert (line["step_s"], line["frames_per_s"], line["remaining_s"]) == pytest.approx((0.5, 4, 1))
    assert line["memory_gb"] > 0.05  # torch alone needs more
    assert {name for name in line if name not in NOT_LOSSES} == {"box_0", "total"}


def test_unknown_values_are_left_out_of_the_line(clock):
    """No GPU, no epochs, and a step whose gradient exceeded the range of float16."""
    timer = StepTimer(trainer_of(4), None)
    timer.wait(lambda: None)
    clock.advance(1)
    line = timer.report(step_of(1, gradient_norm=None)).to_dict()
    assert line.keys() & {"epoch", "gradient_norm", "gpu_memory_gb"} == set()
