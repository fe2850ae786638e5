"""`duospacenet batch`: detect the objects in every scene of one or several sources, with several workers."""

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
    EngineOption,
    EnginePrecisionOption,
    FastDecodingOption,
    HistoryStepOption,
    JsonOption,
    NoCheckOption,
)
from .run import (
    FormatOption,
    OnMissingOption,
    SubmissionMaxBoxesOption,
    SubmissionMinScoreOption,
    SubmissionUsesOption,
    submission_options,
)

SourcesArgument = Annotated[
    list[str],
    typer.Argument(
        help="Scene folders, trusted:FOLDER if the images are outside, nuscenes:ROOT[@VERSION][/SPLIT] or "
        "synthetic:SEED[:FRAMES]. Each scene in them is one job.",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
MapsOption = Annotated[
    bool,
    typer.Option("--maps", help="Segment the map: write masks to maps/ of each scene.", rich_help_panel=OUTPUT),
]
OutOption = Annotated[
    Path,
    typer.Option(
        help="Folder for the results: one folder per scene in scenes/, and summary.json.",
        metavar="FOLDER",
        show_default=False,
        rich_help_panel=OUTPUT,
    ),
]
WorkersOption = Annotated[
    int | None,
    typer.Option(
        "--workers",
        help="Worker processes, each with one scene at a time. Default: the number of cores divided by --threads.",
        metavar="N",
        min=1,
        rich_help_panel=BEHAVIOUR,
    ),
]
RayOption = Annotated[
    str | None,
    typer.Option(
        "--ray",
        help="Run the workers on a Ray cluster (extra ray): local starts Ray on this machine, auto connects to the "
        "cluster of this machine.",
        metavar="local|auto|HOST:PORT",
        rich_help_panel=BEHAVIOUR,
    ),
]
WorkerThreadsOption = Annotated[
    int,
    typer.Option(
        "--threads",
        help="Threads of the engine in each worker. One is fastest if there is a scene for every core; more threads "
        "need less memory per core.",
        metavar="N",
        min=1,
        rich_help_panel=ADVANCED,
    ),
]
ResumeOption = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Continue an interrupted batch: finished scenes stay, failed scenes are tried again. The results equal "
        "those of an uninterrupted batch.",
        rich_help_panel=BEHAVIOUR,
    ),
]


def batch(
    bundle: BundleArgument,
    sources: SourcesArgument,
    out: OutOption,
    workers: WorkersOption = None,
    ray: RayOption = None,
    resume: ResumeOption = False,
    maps: MapsOption = False,
    formats: FormatOption = "jsonl",
    submission_uses: SubmissionUsesOption = None,
    submission_max_boxes: SubmissionMaxBoxesOption = None,
    submission_min_score: SubmissionMinScoreOption = None,
    on_missing: OnMissingOption = "blank",
    history_step: HistoryStepOption = None,
    threads: WorkerThreadsOption = 1,
    engine: EngineOption = "onnxruntime",
    engine_precision: EnginePrecisionOption = "float32",
    fast_decoding: FastDecodingOption = False,
    no_check: NoCheckOption = False,
    as_json: JsonOption = False,
) -> None:
    """Detect the objects in many scenes. Each scene is processed by one worker and gets a folder of results.

    A scene that cannot be processed is reported, and the others go on. The exit code is then 1.

    \b
    Example:
      duospacenet batch out/bundle synthetic:1:8 synthetic:2:8 --out out/batch
    """
    from .. import jobs
    from ..runtime.errors import CheckError
    from .batch_table import print_batch

    behaviour: dict[str, Any] = {"on_missing": on_missing, "history_step_s": history_step, "check": not no_check}
    behaviour |= {"workers": workers, "ray": ray, "threads": threads, "resume": resume, "maps": maps}
    behaviour |= {"engine": engine, "engine_precision": engine_precision, "fast_decoding": fast_decoding}
    names = [name.strip() for name in formats.split(",")]
    submission = submission_options(submission_uses, submission_max_boxes, submission_min_score)
    callbacks: dict[str, Any] = {"progress": show_progress, "notify": print_message}
    summary = jobs.run_batch(bundle, sources, out, formats=names, submission=submission, **callbacks, **behaviour)
    if as_json:
        print_json(summary.to_dict())
    else:
        print_batch(summary)
    if summary.failed:
        raise CheckError(summary.describe_failures())
