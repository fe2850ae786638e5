"""The message on the memory that a training needs."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ...model import DuoSpaceNetConfig
    from ...training import Settings

# Below so many pixels per step, a training needs less than about 2 GB. The estimate would take longer than the steps of
# a quick test.
MIN_PIXELS = 1_000_000


def describe_memory(
    config: "DuoSpaceNetConfig",
    settings: "Settings",
    num_processes: int,
    accumulation_steps: int,
    checkpointing: bool,
) -> str | None:
    """One line with the estimated memory per GPU. None if a step has less than `MIN_PIXELS` pixels.

    num_processes, accumulation_steps: a batch is divided into their product of parts.
    checkpointing: whether activations are checkpointed.
    """
    from ...training.memory_estimate import estimate_memory

    frames = -(-settings.batch_size // (num_processes * accumulation_steps))
    if frames * config.num_cameras * config.image.width_px * config.image.height_px < MIN_PIXELS:
        return None
    estimate = estimate_memory(config, settings, frames, checkpointing, accumulation_steps)
    advice = "" if checkpointing else ". --activation-checkpointing needs less"
    return f"memory per GPU: {estimate}; a CPU needs the same{advice}"
