"""`duospacenet parity`: compare a bundle with its model in PyTorch."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

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
    IgnoreOption,
    JsonOption,
    PresetOption,
    RandomOption,
    WeightsKeyOption,
    WeightsOption,
)

if TYPE_CHECKING:
    from ..jobs.parity_job import BundleParity

RANDOM_INPUTS = 12  # of a graph

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
ParityEngineOption = Annotated[
    str,
    typer.Option(
        "--engine",
        help="Library that runs the graphs. openvino needs the extra openvino, and onnxruntime-web needs Node.js.",
        metavar="onnxruntime|openvino|onnxruntime-web",
        rich_help_panel=BEHAVIOUR,
    ),
]
GoldenOption = Annotated[
    Path | None,
    typer.Option(
        "--golden",
        metavar="FILE",
        help="Compare with PyTorch's values in a file that `export --golden` wrote. PyTorch is then not needed.",
        rich_help_panel=INPUT,
    ),
]
EngineLogOption = Annotated[
    Path | None,
    typer.Option(
        "--engine-log",
        metavar="FILE",
        help="With --golden: compare the outputs of another engine, in a .npz or .json file, instead of running the "
        "graphs. docs/parity.md describes the format.",
        rich_help_panel=INPUT,
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
    random_inputs: RandomInputsOption = RANDOM_INPUTS,
    retrace: RetraceOption = True,
    bisect: BisectOption = False,
    golden: GoldenOption = None,
    engine_log: EngineLogOption = None,
    engine: ParityEngineOption = "onnxruntime",
    as_json: JsonOption = False,
) -> None:
    """Run a bundle and its model in PyTorch side by side, and compare. Exit code 1 if they differ.

    \b
    Examples:
      duospacenet parity out/bundle --weights mine.pth --bisect
      duospacenet parity out/bundle --golden golden.npz --engine openvino
    """
    from .. import jobs

    model: dict[str, Any] = {"weights": weights, "random_weights": random_weights, "seed": seed, "anchors": anchors}
    model |= {"preset": preset, "config": config, "allow_missing": allow_missing, "ignore": ignore}
    model["weights_key"] = weights_key
    checks: dict[str, Any] = {"random_inputs": random_inputs, "retrace": retrace, "bisect": bisect}
    if golden is not None or engine_log is not None:
        result = _check_golden(bundle, golden, engine_log, engine, {"source": source, **model, **checks})
    else:
        checks |= {"sources": source, "engine": engine, "progress": show_progress, "notify": print_message}
        result = jobs.check_bundle_parity(bundle, **model, **checks)
    _print_result(result, as_json)


def _check_golden(
    bundle: Path, golden: Path | None, engine_log: Path | None, engine: str, others: dict[str, Any]
) -> "BundleParity":
    """Compare with a golden file. others: the options that only a comparison with PyTorch takes, by name."""
    from .. import jobs
    from ..runtime.errors import UsageError

    if golden is None:
        raise UsageError("--engine-log: expected with --golden FILE, the file whose inputs the engine got.")
    defaults = {"random_inputs": RANDOM_INPUTS, "retrace": True, "bisect": False, "random_weights": False}
    for name, value in others.items():
        if value != defaults.get(name):
            option = {"retrace": "no-retrace"}.get(name, name).replace("_", "-")
            raise UsageError(f"--golden: expected without --{option}, which only a comparison with PyTorch takes.")
    return jobs.check_golden_parity(bundle, golden, engine=engine, engine_log=engine_log, progress=show_progress)


def _print_result(result: "BundleParity", as_json: bool) -> None:
    """Print the report and the bisection. Raises Exit with code 1 if the check failed."""
    from .parity_table import print_bisection, print_parity

    if as_json:
        print_json(result.to_dict())
    else:
        print_parity(result.report, result.engine)
        if result.bisection:
            print_bisection(result.bisection)
    if not result.report.passed:
        raise typer.Exit(1)
