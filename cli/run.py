"""`duospacenet run`: detect the objects in every frame of one or several sources, without PyTorch."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .console import print_json, print_message, show_progress
from .options import (
    BEHAVIOUR,
    OUTPUT,
    BundleArgument,
    EngineOption,
    EnginePrecisionOption,
    FastDecodingOption,
    HistoryStepOption,
    JsonOption,
    NoCheckOption,
    SourcesArgument,
    ThreadsOption,
)

if TYPE_CHECKING:
    from ..data.nuscenes_submission import SubmissionOptions

OutOption = Annotated[
    Path, typer.Option(help="Folder for the results.", metavar="FOLDER", show_default=False, rich_help_panel=OUTPUT)
]
DrawOption = Annotated[
    bool,
    typer.Option(
        "--draw", help="Write one picture per frame: the cameras beside the bird's-eye view.", rich_help_panel=OUTPUT
    ),
]
VideoOption = Annotated[bool, typer.Option("--video", help="Write the pictures as video.mp4.", rich_help_panel=OUTPUT)]
DrawGroundTruthOption = Annotated[
    bool,
    typer.Option(
        "--draw-ground-truth", help="Draw the source's own boxes too, in green. Implies --draw.", rich_help_panel=OUTPUT
    ),
]
HeatmapsOption = Annotated[
    bool,
    typer.Option(
        "--heatmaps",
        help="Write the network's features as one picture per frame: PV and BEV heatmaps beside the images.",
        rich_help_panel=OUTPUT,
    ),
]
RecordingOption = Annotated[
    Path | None,
    typer.Option(
        help="Record images, boxes, maps and poses for a viewer: .mcap for Foxglove (extra mcap), .rrd for rerun "
        "(extra rerun).",
        metavar="FILE",
        rich_help_panel=OUTPUT,
    ),
]
MapsOption = Annotated[
    bool,
    typer.Option("--maps", help="Segment the map: write masks to maps/, and draw them.", rich_help_panel=OUTPUT),
]
FormatOption = Annotated[
    str,
    typer.Option(
        "--format",
        help="jsonl is always written; jsonl,nuscenes adds the nuScenes submission.",
        metavar="FORMATS",
        rich_help_panel=OUTPUT,
    ),
]
MinScoreOption = Annotated[
    float,
    typer.Option(
        help="Do not draw or record boxes with a lower score.", metavar="SCORE", min=0, max=1, rich_help_panel=OUTPUT
    ),
]
SubmissionUsesOption = Annotated[
    str | None,
    typer.Option(
        help="Data that the results are based on, for the submission's meta: camera, lidar, radar, map, external. "
        "Default: camera.",
        metavar="DATA",
        rich_help_panel=OUTPUT,
    ),
]
SubmissionMaxBoxesOption = Annotated[
    int | None,
    typer.Option(
        help="Boxes per sample of the submission, those with the highest scores. Default: 500.",
        metavar="N",
        min=1,
        max=500,
        rich_help_panel=OUTPUT,
    ),
]
SubmissionMinScoreOption = Annotated[
    float | None,
    typer.Option(
        help="Leave boxes with a lower score out of the submission. Default: 0.",
        metavar="SCORE",
        min=0,
        max=1,
        rich_help_panel=OUTPUT,
    ),
]
OnMissingOption = Annotated[
    str,
    typer.Option(
        help="Frames with lost cameras: blank uses the other cameras, skip leaves the frame out, error stops.",
        metavar="blank|skip|error",
        rich_help_panel=BEHAVIOUR,
    ),
]
OverwriteOption = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Replace the files of an earlier run in --out, once this run is complete.",
        rich_help_panel=BEHAVIOUR,
    ),
]
ResumeOption = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Continue an interrupted run; the output is the same as that of an uninterrupted one.",
        rich_help_panel=BEHAVIOUR,
    ),
]


def run(
    bundle: BundleArgument,
    sources: SourcesArgument,
    out: OutOption,
    draw: DrawOption = False,
    video: VideoOption = False,
    draw_ground_truth: DrawGroundTruthOption = False,
    heatmaps: HeatmapsOption = False,
    recording: RecordingOption = None,
    maps: MapsOption = False,
    formats: FormatOption = "jsonl",
    min_score: MinScoreOption = 0.3,
    submission_uses: SubmissionUsesOption = None,
    submission_max_boxes: SubmissionMaxBoxesOption = None,
    submission_min_score: SubmissionMinScoreOption = None,
    on_missing: OnMissingOption = "blank",
    history_step: HistoryStepOption = None,
    threads: ThreadsOption = None,
    engine: EngineOption = "onnxruntime",
    engine_precision: EnginePrecisionOption = "float32",
    fast_decoding: FastDecodingOption = False,
    overwrite: OverwriteOption = False,
    resume: ResumeOption = False,
    no_check: NoCheckOption = False,
    as_json: JsonOption = False,
) -> None:
    """Detect the objects in every frame of one or several sources.

    \b
    Example:
      duospacenet run out/bundle synthetic:5:20 --out out/run --video
    """
    from .. import jobs
    from .run_table import print_run

    pictures: dict[str, Any] = {"draw": draw, "video": video, "draw_ground_truth": draw_ground_truth}
    pictures |= {"min_score": min_score, "maps": maps, "heatmaps": heatmaps, "recording": recording}
    behaviour: dict[str, Any] = {"on_missing": on_missing, "threads": threads, "overwrite": overwrite, "resume": resume}
    behaviour |= {"check": not no_check, "engine": engine, "engine_precision": engine_precision}
    behaviour |= {"fast_decoding": fast_decoding, "history_step_s": history_step}
    names = [name.strip() for name in formats.split(",")]
    submission = submission_options(submission_uses, submission_max_boxes, submission_min_score)
    callbacks: dict[str, Any] = {"progress": show_progress, "notify": print_message}
    summary = jobs.run(bundle, sources, out, formats=names, submission=submission, **callbacks, **pictures, **behaviour)
    if as_json:
        print_json(summary.to_dict())
    else:
        print_run(summary)


def submission_options(uses: str | None, max_boxes: int | None, min_score: float | None) -> "SubmissionOptions | None":
    """The options that were given, or None without any."""
    from ..data.nuscenes_submission import SubmissionOptions

    given: dict[str, Any] = {"max_boxes": max_boxes, "min_score": min_score}
    given["uses"] = None if uses is None else tuple(name.strip() for name in uses.split(","))
    given = {name: value for name, value in given.items() if value is not None}
    return SubmissionOptions(**given) if given else None
