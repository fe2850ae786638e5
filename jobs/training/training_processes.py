"""The processes of a training: one, or those that torchrun started."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from ...runtime.errors import UsageError
from ...runtime.extras import needs_extra

if TYPE_CHECKING:
    from ...training import Settings
    from ...training.distributed import Processes


@contextmanager
def join_training_processes(device: str) -> "Iterator[Processes]":
    """Join the other training processes while the block runs, see `training.distributed`.

    device: "auto", "cpu", "cuda" or "cuda:N".
    Raises UsageError for a device that is unknown or does not exist.
    """
    with needs_extra("train"):
        from ...training.distributed import join_processes
    with join_processes(device) as processes:
        yield processes


def check_parts(settings: "Settings", processes: "Processes", accumulation_steps: int) -> None:
    """Check that the batch can be divided into equal parts. Raises UsageError."""
    if accumulation_steps < 1:
        raise UsageError(f"--accumulation-steps: expected 1 or more; got {accumulation_steps}.")
    num_parts = processes.count * accumulation_steps
    if settings.batch_size % num_parts:
        raise UsageError(
            f"--batch-size: expected a multiple of {num_parts} (processes: {processes.count}, accumulation steps: "
            f"{accumulation_steps}); got {settings.batch_size}."
        )
