"""The options that say which model is meant: a preset or a bundle's configuration, and its weights."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime.errors import ArtifactError, UsageError
from .console import needs_extra

if TYPE_CHECKING:
    from ..model import DuoSpaceNet, DuoSpaceNetConfig
    from ..runtime.manifest import Weights

WeightsOption = Annotated[Path | None, typer.Option("--weights", help="Checkpoint, .safetensors or weights-only .pth.")]
RandomOption = Annotated[bool, typer.Option("--random-weights", help="Draw the weights at random, from --seed.")]
SeedOption = Annotated[int, typer.Option(help="Seed of --random-weights.", min=0)]


def find_preset(name: str) -> "DuoSpaceNetConfig":
    """The configuration of a preset. Raises UsageError for an unknown one."""
    with needs_extra("export"):
        from ..model import PRESETS
    if name not in PRESETS:
        raise UsageError(f"--preset: expected one of {', '.join(PRESETS)}; got {name!r}.")
    return PRESETS[name]


def build_model(
    config: "DuoSpaceNetConfig", weights: Path | None, random_weights: bool, seed: int
) -> tuple["DuoSpaceNet", "Weights"]:
    """A model with the weights that were asked for, and their provenance.

    Raises UsageError unless exactly one kind was asked for, ArtifactError for a checkpoint that does not fit.
    """
    if (weights is not None) == random_weights:
        raise UsageError("weights: expected either --weights FILE or --random-weights; got both or neither.")
    with needs_extra("export"):
        from ..export.bundle import file_weights
        from ..export.bundle import random_weights as drawn_weights
        from ..model import CheckpointError, DuoSpaceNet, load_checkpoint, randomise
    model = DuoSpaceNet(config)
    if weights is None:
        return randomise(model, seed), drawn_weights(model, seed)
    try:
        metadata = load_checkpoint(weights, model)
    except (CheckpointError, FileNotFoundError) as error:
        raise ArtifactError(str(error)) from error
    return model, file_weights(model, weights, metadata)
