"""The options that say which model is meant: a preset or a bundle's configuration, and its weights."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime.errors import ArtifactError, UsageError
from .console import needs_extra

if TYPE_CHECKING:
    from ..model import CheckpointReport, DuoSpaceNet, DuoSpaceNetConfig
    from ..runtime.manifest import Weights

WeightsOption = Annotated[
    Path | None,
    typer.Option(
        "--weights",
        help="Checkpoint, .safetensors or weights-only .pth: our own layout, torchvision's of a ResNet, detectron2's "
        "of a VoVNet, or mmdetection3d's of an image backbone and neck.",
    ),
]
RandomOption = Annotated[bool, typer.Option("--random-weights", help="Draw the weights at random, from --seed.")]
SeedOption = Annotated[int, typer.Option(help="Seed of what is drawn at random.", min=0)]
AllowMissingOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="PATTERN",
        help="Tensors, by our names (`decoder.*`), that the checkpoint need not have; they are drawn from --seed. "
        "May be given again.",
    ),
]


def find_preset(name: str) -> "DuoSpaceNetConfig":
    """The configuration of a preset. Raises UsageError for an unknown one."""
    with needs_extra("export"):
        from ..model import PRESETS
    if name not in PRESETS:
        raise UsageError(f"--preset: expected one of {', '.join(PRESETS)}; got {name!r}.")
    return PRESETS[name]


def build_model(
    config: "DuoSpaceNetConfig",
    weights: Path | None,
    random_weights: bool,
    seed: int,
    allow_missing: Sequence[str] | None = None,
) -> tuple["DuoSpaceNet", "Weights"]:
    """A model with the weights that were asked for, and their provenance.

    Raises UsageError unless exactly one kind was asked for, ArtifactError for a checkpoint that does not fit.
    """
    if (weights is not None) == random_weights:
        raise UsageError("weights: expected either --weights FILE or --random-weights; got both or neither.")
    if allow_missing and weights is None:
        raise UsageError("--allow-missing: expected with --weights FILE alone; got --random-weights.")
    with needs_extra("export"):
        from ..export.bundle import file_weights
        from ..export.bundle import random_weights as drawn_weights
        from ..model import DuoSpaceNet, load_checkpoint, randomise
    model = DuoSpaceNet(config)
    if weights is None:
        return randomise(model, seed), drawn_weights(model, seed)
    if allow_missing:
        randomise(model, seed)
    with _as_artifact():
        report = load_checkpoint(weights, model, allow_missing or ())
    return model, file_weights(model, weights, report, seed)


def survey_weights(
    config: "DuoSpaceNetConfig", weights: Path, allow_missing: Sequence[str] | None
) -> "CheckpointReport":
    """How a checkpoint fits a configuration, without loading it. Raises ArtifactError where it cannot be read."""
    with needs_extra("export"):
        import torch

        from ..model import DuoSpaceNet, read_checkpoint
    with torch.device("meta"):
        model = DuoSpaceNet(config)
    with _as_artifact():
        return read_checkpoint(weights, model, allow_missing or ()).report


@contextmanager
def _as_artifact() -> Iterator[None]:
    """Around reading a checkpoint: its failures end the command as a bad artifact."""
    from ..model import CheckpointError

    try:
        yield
    except CheckpointError as error:
        advice = "" if error.report is None else " `duospacenet export --dry-run` prints the whole report."
        raise ArtifactError(f"{error}{advice}") from error
    except FileNotFoundError as error:
        raise ArtifactError(str(error)) from error
