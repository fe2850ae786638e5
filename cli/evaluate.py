"""`duospacenet eval`: detection and map metrics of a bundle or of a submission, by the rules of nuScenes."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.errors import UsageError
from .console import print_json, print_message, show_progress
from .options import (
    BEHAVIOUR,
    INPUT,
    OUTPUT,
    AnchorsOption,
    EngineOption,
    EnginePrecisionOption,
    FastDecodingOption,
    HistoryStepOption,
    JsonOption,
    LimitOption,
    NoCheckOption,
    ThreadsOption,
    WeightsOption,
)

if TYPE_CHECKING:
    from ..jobs.scoring import BundleScores
    from ..jobs.submission_scoring import SubmissionScores

NamesArgument = Annotated[
    list[str],
    typer.Argument(
        help="Folder of a bundle, then one or several sources with true boxes or masks: scene folders, "
        "trusted:FOLDER, nuscenes:ROOT[@VERSION][/SPLIT] or synthetic:SEED[:FRAMES]. With --results only the sources.",
        metavar="[BUNDLE] SOURCE",
        show_default=False,
        rich_help_panel=INPUT,
    ),
]
ResultsOption = Annotated[
    Path | None,
    typer.Option(
        help="Evaluate a nuScenes submission file of any detector instead of a bundle. It must have all sample tokens "
        "of the sources and no others.",
        metavar="FILE",
        rich_help_panel=INPUT,
    ),
]
_DEFAULTS: dict[str, Any] = {  # of the options that only apply to a bundle
    "eager": False,
    "weights": None,
    "anchors": None,
    "threads": None,
    "engine": "onnxruntime",
    "engine_precision": "float32",
    "single_frame": False,
    "limit": None,
    "fast_decoding": False,
    "check": True,
    "history_step_s": None,
    "lost_cameras": False,
}
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
        help="New folder for precision.png and errors.png, and lost_cameras.png with --lost-cameras. Needs the extra "
        "viz.",
        metavar="FOLDER",
        rich_help_panel=OUTPUT,
    ),
]
LostCamerasOption = Annotated[
    bool,
    typer.Option(
        "--lost-cameras",
        help="Evaluate with 1, 2, ... cameras lost in every frame too, chosen at random. Each number costs one more "
        "evaluation.",
        rich_help_panel=BEHAVIOUR,
    ),
]


def evaluate(
    names: NamesArgument,
    results: ResultsOption = None,
    single_frame: SingleFrameOption = False,
    limit: LimitOption = None,
    history_step: HistoryStepOption = None,
    eager: EagerOption = False,
    weights: WeightsOption = None,
    anchors: AnchorsOption = None,
    threads: ThreadsOption = None,
    engine: EngineOption = "onnxruntime",
    engine_precision: EnginePrecisionOption = "float32",
    fast_decoding: FastDecodingOption = False,
    lost_cameras: LostCamerasOption = False,
    plots: PlotsOption = None,
    no_check: NoCheckOption = False,
    as_json: JsonOption = False,
) -> None:
    """Compare detections with the ground truth of sources: AP, the five errors, NDS and the IoU of maps.

    \b
    Examples:
      duospacenet eval out/bundle synthetic:100:16 synthetic:101:16
      duospacenet eval --results submission.json nuscenes:/data/nuscenes/val
    """
    from ..jobs.score_plots import check_plots, write_plots
    from .score_table import print_scores

    options: dict[str, Any] = {"eager": eager, "weights": weights, "anchors": anchors, "threads": threads}
    options |= {"engine": engine, "engine_precision": engine_precision}
    options |= {"single_frame": single_frame, "limit": limit, "fast_decoding": fast_decoding, "check": not no_check}
    options |= {"history_step_s": history_step, "lost_cameras": lost_cameras}
    _check_names(names, results, options)
    if plots is not None:
        check_plots(plots)
    scores = _evaluate(names, results, options)
    if as_json:
        print_json(scores.to_dict())
    else:
        print_scores(scores)
    if plots is not None:
        write_plots(plots, scores.report, scores.lost_cameras)


def _evaluate(names: list[str], results: Path | None, options: dict[str, Any]) -> "BundleScores | SubmissionScores":
    """Evaluate a bundle on sources, or a submission if there is one."""
    from .. import jobs

    if results is not None:
        return jobs.evaluate_submission(results, names, progress=show_progress)
    bundle, *sources = names
    return jobs.evaluate_bundle(bundle, sources, **options, progress=show_progress, notify=print_message)


def _check_names(names: list[str], results: Path | None, options: dict[str, Any]) -> None:
    """Check the arguments: a bundle and its sources, or a submission without options of a bundle. Raises UsageError."""
    if results is None:
        if len(names) < 2:
            raise UsageError(
                f"expected a bundle and at least one source, or --results FILE and sources; got {names[0]!r} only."
            )
        return
    given = [name for name, value in options.items() if value != _DEFAULTS[name]]
    if given:
        option = "--no-check" if given[0] == "check" else f"--{given[0].removesuffix('_s').replace('_', '-')}"
        raise UsageError(f"{option}: expected only with a bundle; got --results. Leave out one of them.")
