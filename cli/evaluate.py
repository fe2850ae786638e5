"""`duospacenet eval`: detection and map metrics of a bundle, by the rules of nuScenes."""

from pathlib import Path
from typing import Annotated, Any

import typer

from .console import print_json, print_message, show_progress
from .options import (
    BEHAVIOUR,
    INPUT,
    OUTPUT,
    AnchorsOption,
    BundleArgument,
    EngineOption,
    EnginePrecisionOption,
    FastDecodingOption,
    JsonOption,
    LimitOption,
    NoCheckOption,
    ThreadsOption,
    WeightsOption,
)

SourcesArgument = Annotated[
    list[str],
    typer.Argument(
        help="Scene folders with true boxes, trusted:FOLDER, or synthetic:SEED[:FRAMES].",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
SingleFrameOption = Annotated[
    bool,
    typer.Option(
        "--single-frame", help="Reset the history before every frame: no temporal window.", rich_help_panel=BEHAVIOUR
    ),
]
EagerOption = Annotated[
    bool,
    typer.Option(
        "--eager",
        help="Evaluate the model in PyTorch instead of the bundle. Needs --weights.",
        rich_help_panel=BEHAVIOUR,
    ),
]
PlotsOption = Annotated[
    Path | None,
    typer.Option(
        help="New folder for precision.png and errors.png. Needs the extra viz.",
        metavar="FOLDER",
        rich_help_panel=OUTPUT,
    ),
]


def evaluate_bundle(
    bundle: BundleArgument,
    sources: SourcesArgument,
    single_frame: SingleFrameOption = False,
    limit: LimitOption = None,
    eager: EagerOption = False,
    weights: WeightsOption = None,
    anchors: AnchorsOption = None,
    threads: ThreadsOption = None,
    engine: EngineOption = "onnxruntime",
    engine_precision: EnginePrecisionOption = "float32",
    fast_decoding: FastDecodingOption = False,
    plots: PlotsOption = None,
    no_check: NoCheckOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compare a bundle's detections with the ground truth of sources: AP, the five errors, NDS and the IoU of maps.

    \b
    Example:
      duospacenet eval out/bundle synthetic:100:16 synthetic:101:16
    """
    from .. import jobs
    from ..jobs.scoring import check_plots, write_plots
    from .score_table import print_scores

    if plots is not None:
        check_plots(plots)
    detector: dict[str, Any] = {"eager": eager, "weights": weights, "anchors": anchors, "threads": threads}
    detector |= {"engine": engine, "engine_precision": engine_precision}
    frames: dict[str, Any] = {"single_frame": single_frame, "limit": limit, "check": not no_check}
    frames |= {"fast_decoding": fast_decoding}
    callbacks: dict[str, Any] = {"progress": show_progress, "notify": print_message}
    scores = jobs.evaluate_bundle(bundle, sources, **detector, **frames, **callbacks)
    if as_json:
        print_json(scores.to_dict())
    else:
        print_scores(scores.report)
    if plots is not None:
        write_plots(plots, scores.report)
