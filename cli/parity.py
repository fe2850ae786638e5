"""`duospacenet parity`: compare a bundle with its model in PyTorch."""

from typing import Annotated, Any

import typer

from .console import print_json, print_message, show_progress
from .options import (
    ADVANCED,
    BEHAVIOUR,
    INPUT,
    AllowMissingOption,
    AnchorsOption,
    BundleArgument,
    ConfigOption,
    EngineOption,
    IgnoreOption,
    JsonOption,
    PresetOption,
    RandomOption,
    WeightsKeyOption,
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
    list[str] | None,
    typer.Option(
        "--source",
        help="Frames to compare on after the stress sequence: a scene folder, trusted:FOLDER, or "
        "synthetic:SEED[:FRAMES]. Repeatable.",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
RandomInputsOption = Annotated[
    int,
    typer.Option(
        "--random-inputs",
        help="Number of random inputs of a graph. They are the same in every run.",
        metavar="N",
        min=0,
        rich_help_panel=ADVANCED,
    ),
]
RetraceOption = Annotated[
    bool,
    typer.Option(
        "--retrace/--no-retrace",
        help="Also export the model again, and compare the operators and constants of the graphs.",
        rich_help_panel=ADVANCED,
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
    preset: PresetOption = None,
    config: ConfigOption = None,
    seed: SeedOption = None,
    allow_missing: AllowMissingOption = None,
    ignore: IgnoreOption = None,
    weights_key: WeightsKeyOption = None,
    anchors: AnchorsOption = None,
    source: SourceOption = None,
    random_inputs: RandomInputsOption = 12,
    retrace: RetraceOption = True,
    bisect: BisectOption = False,
    engine: EngineOption = "onnxruntime",
    as_json: JsonOption = False,
) -> None:
    """Run a bundle and its model in PyTorch side by side, and compare. Exit code 1 if they differ.

    \b
    Example:
      duospacenet parity out/bundle --weights mine.pth --bisect
    """
    from .. import jobs
    from .parity_table import print_bisection, print_parity

    model: dict[str, Any] = {"weights": weights, "random_weights": random_weights, "seed": seed, "anchors": anchors}
    model |= {"preset": preset, "config": config, "allow_missing": allow_missing, "ignore": ignore}
    checks: dict[str, Any] = {"sources": source, "random_inputs": random_inputs, "retrace": retrace, "bisect": bisect}
    checks["engine"] = engine
    callbacks: dict[str, Any] = {"progress": show_progress, "notify": print_message}
    result = jobs.check_bundle_parity(bundle, weights_key=weights_key, **model, **checks, **callbacks)
    if as_json:
        print_json(result.to_dict())
    else:
        print_parity(result.report, result.engine)
        if result.bisection:
            print_bisection(result.bisection)
    if not result.report.passed:
        raise typer.Exit(1)
