"""Tests of data-parallel training: two gloo processes equal one process with the whole batch."""

import pytest
import torch

from duospacenet.runtime.errors import InputError, UsageError
from duospacenet.runtime.process_errors import LostProcessError, OtherProcessError
from duospacenet.training import distributed
from duospacenet.training.distributed import Processes, find_device
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


# --- Devices ------------------------------------------------------------------------------------------------------


@pytest.fixture
def two_gpus(monkeypatch):
    """torch reports two GPUs. Returns the indices that are chosen."""
    chosen: list[int] = []
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.device_count", lambda: 2)
    monkeypatch.setattr("torch.cuda.set_device", chosen.append)
    return chosen


@pytest.mark.parametrize(
    ("name", "local_rank", "expected"),
    [("cpu", 1, "cpu"), ("auto", 0, "cuda:0"), ("cuda", 1, "cuda:1"), ("cuda", 3, "cuda:1"), ("cuda:0", 1, "cuda:0")],
)
def test_each_process_has_its_own_gpu_unless_one_is_named(two_gpus, monkeypatch, name, local_rank, expected):
    monkeypatch.setenv("LOCAL_RANK", str(local_rank))
    assert str(find_device(name)) == expected
    assert two_gpus == ([] if expected == "cpu" else [int(expected[-1])])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("cuda:2", "--device: expected a GPU below cuda:2; got cuda:2. torch found 2 GPU"),
        ("cuda:", "--device: expected auto, cpu, cuda or cuda:N; got 'cuda:'"),
        ("gpu", "--device: expected auto, cpu, cuda or cuda:N; got 'gpu'"),
    ],
)
def test_a_gpu_that_does_not_exist_is_refused(two_gpus, name, message):
    with pytest.raises(UsageError, match=message):
        find_device(name)


def test_without_a_gpu_auto_is_the_cpu_and_cuda_is_refused(monkeypatch):
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    assert str(find_device("auto")) == "cpu"
    with pytest.raises(UsageError, match="expected a GPU for cuda:0; torch found none"):
        find_device("cuda:0")


@pytest.mark.parametrize(
    ("device", "num_processes", "expected"), [("cuda", 2, "nccl"), ("cuda", 4, "gloo"), ("cuda:1", 2, "gloo")]
)
def test_processes_with_their_own_gpus_use_nccl(two_gpus, monkeypatch, device, num_processes, expected):
    """NCCL refuses two processes on one GPU."""
    started: list[str] = []
    monkeypatch.setattr("torch.distributed.is_nccl_available", lambda: True)
    monkeypatch.setattr("torch.distributed.init_process_group", lambda backend, **_: started.append(backend))
    monkeypatch.setenv("LOCAL_WORLD_SIZE", str(num_processes))
    processes = Processes(0, num_processes, torch.device("cuda", 0))
    distributed._start_group(processes, device, torch.distributed.HashStore())
    assert started == [expected]


# --- Errors -------------------------------------------------------------------------------------------------------


@pytest.fixture
def errors(monkeypatch):
    monkeypatch.setenv("RANK", "1")
    return torch.distributed.HashStore()


def test_the_first_error_is_raised_as_it_is(errors):
    distributed._raise_once(InputError("damaged"), errors)  # returns, and `join_processes` raises the error again
    assert errors.get("first") == b"1 3"


def test_a_process_that_fails_later_has_the_exit_code_of_the_first(errors):
    errors.set("first", "0 5")
    with pytest.raises(OtherProcessError) as raised:
        distributed._raise_once(RuntimeError("Connection closed by peer"), errors)
    assert raised.value.exit_code == 5


def test_a_lost_connection_without_an_error_is_a_killed_process(errors):
    with pytest.raises(LostProcessError, match="Start all processes again with --resume"):
        distributed._raise_once(RuntimeError("[gloo/transport/tcp/pair.cc] Connection closed by peer"), errors)
    assert errors.get("first") == b"1 130"


def test_a_bug_is_not_taken_for_a_lost_process(errors):
    distributed._raise_once(RuntimeError("The size of tensor a (3) must match the size of tensor b (4)"), errors)
    assert errors.get("first") == b"1 70"
