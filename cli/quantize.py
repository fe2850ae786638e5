"""`duospacenet quantize`: make an int8 bundle from a float32 bundle."""

from pathlib import Path
from typing import Annotated, Any

import typer

from .console import print_json, print_message, show_progress
from .options import (
    ADVANCED,
    BEHAVIOUR,
    INPUT,
    OUTPUT,
    BundleArgument,
    JsonOption,
    LimitOption,
    NoCheckOption,
    ThreadsOption,
)

SourceOption = Annotated[
    list[str],
    typer.Option(
        "--source",
        help="Frames for the calibration: a scene folder, trusted:FOLDER, nuscenes:ROOT[@VERSION][/SPLIT] or "
        "synthetic:SEED[:FRAMES]. Without --eval-source, their second half is compared instead. Repeatable.",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
EvalSourceOption = Annotated[
    list[str] | None,
    typer.Option(
        "--eval-source",
        help="Other frames, on which the int8 bundle is compared with the float32 bundle. Repeatable.",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
OutOption = Annotated[
    Path, typer.Option("--out", help="New folder for the int8 bundle.", metavar="FOLDER", rich_help_panel=OUTPUT)
]
NoMetricsOption = Annotated[
    bool,
    typer.Option(
        "--no-metrics",
        help="For sources without true boxes: record the agreement of the detections instead of metrics.",
        rich_help_panel=BEHAVIOUR,
    ),
]
CalibrationFramesOption = Annotated[
    int,
    typer.Option(
        "--calibration-frames",
        help="Number of frames for the calibration, at most.",
        metavar="N",
        min=1,
        rich_help_panel=ADVANCED,
    ),
]


def quantize(
    bundle: BundleArgument,
    source: SourceOption,
    out: OutOption,
    eval_source: EvalSourceOption = None,
    no_metrics: NoMetricsOption = False,
    limit: LimitOption = None,
    calibration_frames: CalibrationFramesOption = 32,
    threads: ThreadsOption = None,
    no_check: NoCheckOption = False,
    as_json: JsonOption = False,
) -> None:
    """Quantize a float32 bundle to int8. The new bundle is only written if its metrics hold.

    \b
    Example:
      duospacenet quantize out/bundle --source a/ --eval-source b/ --out int8
    """
    from .. import jobs
    from .quantization_table import print_quantization

    frames: dict[str, Any] = {"eval_sources": eval_source or (), "limit": limit, "check": not no_check}
    frames |= {"metrics": not no_metrics, "calibration_frames": calibration_frames}
    callbacks: dict[str, Any] = {"progress": show_progress, "notify": print_message}
    quantized = jobs.quantize_bundle(bundle, source, out, threads=threads, **frames, **callbacks)
    if as_json:
        print_json(quantized.to_dict())
    else:
        print_quantization(quantized.record)
        print_message(f"wrote {quantized.bundle}")
