"""`duospacenet bench`: measure the speed and memory of a bundle."""

from pathlib import Path
from typing import Annotated, Any

import typer

from .console import print_json, print_message, show_progress
from .options import (
    BEHAVIOUR,
    INPUT,
    OUTPUT,
    BundleArgument,
    EngineOption,
    EnginePrecisionOption,
    JsonOption,
    NoCheckOption,
    ThreadsOption,
    WeightsOption,
)

SourceOption = Annotated[
    str | None,
    typer.Option(
        help="Frames to repeat: a scene folder, trusted:FOLDER, nuscenes:ROOT[@VERSION][/SPLIT] or "
        "synthetic:SEED[:FRAMES]. Default: synthetic frames of 1600×900 px.",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
AgainstOption = Annotated[
    list[str] | None,
    typer.Option(
        help="Alternatives to measure in the same rounds, separated by commas: eager, compile, stateless, openvino, "
        "folders of bundles, openvino:FOLDER or onnxruntime:FOLDER. Repeatable.",
        metavar="LIST",
        rich_help_panel=INPUT,
    ),
]
QueriesOption = Annotated[
    int,
    typer.Option(
        help="Least number of measured frames. p90 needs 10, p99 100, p99.9 1000. MLPerf's SingleStream asks for 6636.",
        metavar="N",
        min=1,
        rich_help_panel=BEHAVIOUR,
    ),
]
RoundsOption = Annotated[
    int,
    typer.Option(
        help="Number of rounds. In each, every alternative runs once. Ratios are medians over the rounds.",
        metavar="N",
        min=1,
        rich_help_panel=BEHAVIOUR,
    ),
]
StreamsOption = Annotated[
    str,
    typer.Option(
        help="Numbers of streams for the throughput, separated by commas; 0 for none.",
        metavar="LIST",
        rich_help_panel=BEHAVIOUR,
    ),
]
ProfileOption = Annotated[
    bool,
    typer.Option("--profile", help="Also measure the time of each kind of operator.", rich_help_panel=BEHAVIOUR),
]
PlotOption = Annotated[
    Path | None,
    typer.Option(
        help="New PNG file: one stacked bar of stages per alternative. Needs the extra viz.",
        metavar="FILE",
        rich_help_panel=OUTPUT,
    ),
]
CompareOption = Annotated[
    Path | None,
    typer.Option(
        help="Earlier output of --json. Exit code 1 if a figure became worse by more than --max-regression.",
        metavar="FILE",
        rich_help_panel=BEHAVIOUR,
    ),
]
MaxRegressionOption = Annotated[
    str,
    typer.Option(
        help="Largest permitted slowdown against --compare, in percent.",
        metavar="PERCENT",
        rich_help_panel=BEHAVIOUR,
    ),
]


def bench(
    bundle: BundleArgument,
    source: SourceOption = None,
    against: AgainstOption = None,
    weights: WeightsOption = None,
    queries: QueriesOption = 50,
    rounds: RoundsOption = 10,
    streams: StreamsOption = "1,2,4",
    profile: ProfileOption = False,
    compare: CompareOption = None,
    max_regression: MaxRegressionOption = "10%",
    engine: EngineOption = "onnxruntime",
    engine_precision: EnginePrecisionOption = "float32",
    threads: ThreadsOption = None,
    no_check: NoCheckOption = False,
    plot: PlotOption = None,
    as_json: JsonOption = False,
) -> None:
    """Measure latency by stage, throughput and memory, beside alternatives in the same run.

    \b
    Example:
      duospacenet bench out/bundle --against eager,stateless --plot speed.png
    """
    from .. import jobs
    from ..jobs.benchmarking.bench_options import parse_percent, parse_streams
    from .bench_table import print_bench

    frames: dict[str, Any] = {"source": source, "check": not no_check, "queries": queries, "rounds": rounds}
    kinds: dict[str, Any] = {"streams": parse_streams(streams), "profile": profile, "plot": plot}
    targets: dict[str, Any] = {"against": against or [], "weights": weights, "threads": threads}
    targets |= {"engine": engine, "engine_precision": engine_precision}
    limits: dict[str, Any] = {"compare": compare, "max_regression": parse_percent(max_regression)}
    callbacks: dict[str, Any] = {"progress": show_progress, "notify": print_message}
    result = jobs.bench_bundle(bundle, **frames, **kinds, **targets, **limits, **callbacks)
    if as_json:
        print_json(result.to_dict())
    else:
        print_bench(result)
    if result.exit_code:
        raise typer.Exit(result.exit_code)
