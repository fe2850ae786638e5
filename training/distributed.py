"""Data-parallel training: the processes that torchrun starts, their devices, and errors that end all of them."""

import os
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta

import torch
import torch.distributed as dist
from torch import Tensor

from ..runtime.errors import (
    INTERNAL_ERROR_EXIT_CODE,
    INTERRUPTED_EXIT_CODE,
    DuoSpaceNetError,
    UsageError,
)
from ..runtime.process_errors import LostProcessError, OtherProcessError

# Between two exchanges, the first process may validate on thousands of frames or write a checkpoint while the others
# wait. A process that ends is noticed without a timeout.
EXCHANGE_TIMEOUT = timedelta(hours=12)
START_TIMEOUT = timedelta(minutes=30)
STORE_TIMEOUT = timedelta(seconds=10)
_LOST_CONNECTION = re.compile(r"gloo|nccl|connection|peer|timed out|timeout|socket", re.IGNORECASE)


@dataclass(frozen=True)
class Processes:
    """The processes of a training, as one of them sees them.

    rank: the number of this process, 0 to count - 1.
    count: the number of processes.
    device: the device of this process.
    """

    rank: int = 0
    count: int = 1
    device: torch.device = field(default_factory=lambda: torch.device("cpu"))

    @property
    def is_first(self) -> bool:
        """Whether this is the process that writes files and messages."""
        return self.rank == 0

    def sum(self, tensor: Tensor) -> Tensor:
        """The sum of a tensor over all processes. It must have the same shape in all of them. Changes `tensor`."""
        if self.count > 1:
            dist.all_reduce(tensor)
        return tensor

    def wait(self) -> None:
        """Wait until all processes are here."""
        if self.count > 1:
            self.sum(torch.zeros(1, device=self.device)).item()


@contextmanager
def join_processes(device: str) -> Iterator[Processes]:
    """Join the other training processes while the block runs. Without torchrun, there is one process only.

    device: "auto", "cpu", "cuda" or "cuda:N". With "cuda" and "auto", each process on a machine has its own GPU, as
        long as there are enough; "cuda:N" is one GPU for all. The processes communicate by NCCL if each has its own
        GPU, and by gloo otherwise.

    An error in one process ends all of them. The block raises the error in the first process that fails, and
    OtherProcessError, with the exit code of that error, in the others. It raises LostProcessError if a process ended
    without an error, for example because it was killed. A block within another joins the same processes.

    Raises UsageError for a device that is unknown or does not exist.
    """
    if not dist.is_torchelastic_launched() or int(os.environ["WORLD_SIZE"]) == 1:
        yield Processes(device=find_device(device))
        return
    rank, count = int(os.environ["RANK"]), int(os.environ["WORLD_SIZE"])
    if dist.is_initialized():
        yield Processes(rank, count, find_device(device))
        return
    store, _, _ = next(dist.rendezvous("env://", timeout=START_TIMEOUT))
    errors = dist.PrefixStore("error", store)
    try:
        processes = Processes(rank, count, find_device(device))
        _start_group(processes, device, store)
        with warnings.catch_warnings():
            # DDP warns of 1×1 convolutions, whose gradients have another layout on paper only.
            warnings.filterwarnings("ignore", "Grad strides do not match bucket view strides")
            warnings.filterwarnings("ignore", "`broadcast_buffers` is deprecated")  # by torch 2.13; needed before it
            yield processes
    except BaseException as error:
        _raise_once(error, errors)
        raise
    dist.destroy_process_group()


def find_device(name: str) -> torch.device:
    """The device of this process, see `join_processes`. A GPU becomes torch's current device.

    Raises UsageError for a device that is unknown or does not exist.
    """
    parts = re.fullmatch(r"(auto|cpu|cuda)|cuda:(\d{1,3})", name)
    if parts is None:
        raise UsageError(f"--device: expected auto, cpu, cuda or cuda:N; got {name!r}.")
    num_gpus = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if name == "cpu" or (name == "auto" and not num_gpus):
        return torch.device("cpu")
    if not num_gpus:
        raise UsageError(
            f"--device: expected a GPU for {name}; torch found none. Leave --device out to train on the CPU."
        )
    index = int(parts[2]) if parts[2] else int(os.environ.get("LOCAL_RANK", "0")) % num_gpus
    if index >= num_gpus:
        raise UsageError(f"--device: expected a GPU below cuda:{num_gpus}; got {name}. torch found {num_gpus} GPU(s).")
    torch.cuda.set_device(index)
    return torch.device("cuda", index)


def _start_group(processes: Processes, device: str, store: dist.Store) -> None:
    """Start the process group, with NCCL if each process has its own GPU. NCCL refuses two processes on one GPU."""
    own_gpu = processes.device.type == "cuda" and ":" not in device
    own_gpu = own_gpu and int(os.environ["LOCAL_WORLD_SIZE"]) <= torch.cuda.device_count()
    backend = "nccl" if own_gpu and dist.is_nccl_available() else "gloo"
    dist.init_process_group(
        backend,
        store=dist.PrefixStore("group", store),
        rank=processes.rank,
        world_size=processes.count,
        timeout=EXCHANGE_TIMEOUT,
    )


def _raise_once(error: BaseException, errors: dist.Store) -> None:
    """Raise OtherProcessError if another process failed before, LostProcessError if another process was killed.

    errors: the place where the first process that fails leaves its exit code.
    """
    lost = isinstance(error, RuntimeError) and _LOST_CONNECTION.search(str(error)) is not None
    code = INTERRUPTED_EXIT_CODE if lost else _exit_code(error)
    first = _first_exit_code(errors, code)
    if first is not None and not isinstance(error, KeyboardInterrupt):
        raise OtherProcessError(first) from error
    if lost:
        raise LostProcessError(
            "expected an answer from all processes of the training; got none from one of them. It was killed, or its "
            "machine cannot be reached. Start all processes again with --resume to continue from the last checkpoint."
        ) from error


def _first_exit_code(errors: dist.Store, code: int) -> int | None:
    """The exit code of the process that failed first. None if it is this process, whose exit code is `code`."""
    mine = f"{os.environ['RANK']} {code}"
    try:
        errors.set_timeout(STORE_TIMEOUT)
        first = errors.compare_set("first", "", mine).decode()
    except RuntimeError:  # torchrun itself has ended
        return None
    return None if first == mine else int(first.split()[1])


def _exit_code(error: BaseException) -> int:
    if isinstance(error, DuoSpaceNetError):
        return error.exit_code
    return INTERRUPTED_EXIT_CODE if isinstance(error, KeyboardInterrupt) else INTERNAL_ERROR_EXIT_CODE
