"""Tests of data-parallel training: two gloo processes equal one process with the whole batch."""

import pytest
import torch

from duospacenet.training.distributed import Processes
from tests.helpers.process_group import start_processes, wait_for_processes
from tests.helpers.trained_steps import HISTORIES, trained_steps


def assert_equal_trainings(ours, expected):
    """Losses and gradients are equal up to rounding.

    AdamW divides by the size of the gradient. A weight whose gradient is nearly 0 therefore follows rounding errors. So
    the weights are compared in sum.
    """
    assert len(ours["steps"]) == len(expected["steps"])
    for (losses, norm, num_frames), (expected_losses, expected_norm, expected_frames) in zip(
        ours["steps"], expected["steps"], strict=True
    ):
        assert losses == pytest.approx(expected_losses, rel=1e-3, abs=1e-5)
        assert norm == pytest.approx(expected_norm, rel=1e-2)
        assert num_frames == expected_frames
    assert ours["steps"][0][0] == pytest.approx(expected["steps"][0][0], rel=1e-5)
    assert ours["gradient"].keys() == expected["gradient"].keys()
    for name, gradient in expected["gradient"].items():
        largest = float(gradient.abs().max())
        torch.testing.assert_close(ours["gradient"][name], gradient, rtol=1e-3, atol=1e-4 * largest + 1e-7)
    start = expected["start"]
    difference = sum(float((ours["end"][name] - end).abs().sum()) for name, end in expected["end"].items())
    change = sum(float((start[name] - end).abs().sum()) for name, end in expected["end"].items())
    assert difference < 0.01 * change


def without_counters(state):
    """A state dict without the numbers of BatchNorm's batches, which nothing depends on: the momentum is constant."""
    return {name: value for name, value in state.items() if not name.endswith("num_batches_tracked")}


@pytest.fixture(scope="module")
def whole_batch():
    """The results of one process with the whole batch, by history."""
    return {history: trained_steps(history, Processes()) for history in HISTORIES}


@pytest.fixture(scope="module")
def two_processes(tmp_path_factory):
    """The folder with the results of two processes."""
    folder = tmp_path_factory.mktemp("two")
    for code, _, error in wait_for_processes(start_processes(["tests.helpers.trained_steps", str(folder)])):
        assert code == 0, error
    return folder


@pytest.mark.parametrize("history", HISTORIES)
def test_two_processes_equal_one_process_with_the_whole_batch(history, two_processes, whole_batch):
    """With "stream", the second process has no frames left in some steps."""
    first, second = (torch.load(two_processes / f"{history}.{rank}", weights_only=True) for rank in range(2))
    assert_equal_trainings(first, whole_batch[history])
    assert first["steps"] == second["steps"]
    for part in ("model", "heads", "average", "optimiser"):  # with the BatchNorm statistics
        ours, other = (without_counters(results["state"][part]) for results in (first, second))
        torch.testing.assert_close(ours, other, rtol=0, atol=0)


@pytest.mark.parametrize("history", HISTORIES)
def test_accumulated_gradients_equal_those_of_the_whole_batch(history, whole_batch):
    assert_equal_trainings(trained_steps(history, Processes(), accumulation_steps=4), whole_batch[history])
