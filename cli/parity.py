"""`duospacenet parity`: compare a bundle with its model in PyTorch."""

from typing import Annotated, Any

import typer

from .console import print_json, print_message, show_progress
from .options import (
    BEHAVIOUR,
    INPUT,
    AllowMissingOption,
    AnchorsOption,
    BundleArgument,
    JsonOption,
    RandomOption,
    WeightsOption,
)

SeedOption = Annotated[
    int | None,
    typer.Option(
        help="Seed of randomly initialised weights. Default: the seed in the bundle's manifest, or 0.",
        min=0,
        metavar="N",
        rich_help_panel=INPUT,
    ),
]
SourceOption = Annotated[
    str | None,
    typer.Option(
        help="Frames to compare on: a scene folder, or synthetic:SEED[:FRAMES]. Default: the stress sequence.",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
BisectOption = Annotated[
    bool,
    typer.Option(
        "--bisect",
        help="If the outputs differ, find the first graph, and in it the first tensor, that differs.",
        rich_help_panel=BEHAVIOUR,
    ),
]


def parity(
    bundle: BundleArgument,
    weights: WeightsOption = None,
    random_weights: RandomOption = False,
    seed: SeedOption = None,
    allow_missing: AllowMissingOption = None,
    anchors: AnchorsOption = None,
    source: SourceOption = None,
    bisect: BisectOption = False,
    as_json: JsonOption = False,
) -> None:
    """Run a bundle and its model in PyTorch side by side, and compare. Exit code 1 if they differ.

    \b
    Example:
      duospacenet parity out/bundle --weights mine.pth --bisect
    """
    from .. import jobs
    from .parity_table import print_bisection, print_parity

    model: dict[str, Any] = {"weights": weights, "random_weights": random_weights, "seed": seed}
    model |= {"allow_missing": allow_missing, "anchors": anchors}
    callbacks: dict[str, Any] = {"progress": show_progress, "notify": print_message}
    result = jobs.check_bundle_parity(bundle, source=source, bisect=bisect, **model, **callbacks)
    if as_json:
        print_json(result.to_dict())
    else:
        print_parity(result.report)
        if result.bisection:
            print_bisection(result.bisection)
    if not result.report.passed:
        raise typer.Exit(1)
