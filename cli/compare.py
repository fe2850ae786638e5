"""`duospacenet compare`: pictures of several results beside one ground truth."""

from pathlib import Path
from typing import Annotated, Any

import typer

from .console import print_json, print_result, show_progress
from .options import INPUT, OUTPUT, JsonOption

NamesArgument = Annotated[
    list[str],
    typer.Argument(
        help="Folders of duospacenet run, or their results.jsonl, all over the same frames; then the source of these "
        "runs, or the sources.",
        metavar="RESULTS SOURCE",
        rich_help_panel=INPUT,
    ),
]
OutOption = Annotated[
    Path,
    typer.Option(
        help="New folder for above/ and cameras/.", metavar="FOLDER", show_default=False, rich_help_panel=OUTPUT
    ),
]
FrameOption = Annotated[
    list[str] | None,
    typer.Option(
        "--frame",
        help="Token of a frame, or its index from 0. Repeatable. Default: all frames of the results.",
        metavar="FRAME",
        rich_help_panel=INPUT,
    ),
]
CameraOption = Annotated[
    list[str] | None,
    typer.Option(
        "--camera",
        help="Name of a camera to draw, from left to right. Repeatable. Default: all cameras.",
        metavar="NAME",
        rich_help_panel=OUTPUT,
    ),
]
NameOption = Annotated[
    list[str] | None,
    typer.Option(
        "--name",
        help="Name of a result in the pictures, one per result. Repeatable. Default: the name of its folder.",
        metavar="NAME",
        rich_help_panel=OUTPUT,
    ),
]
MinScoreOption = Annotated[
    float,
    typer.Option(help="Do not draw boxes with a lower score.", metavar="SCORE", min=0, max=1, rich_help_panel=OUTPUT),
]
EllipsesOption = Annotated[
    bool,
    typer.Option(
        "--ellipses",
        help="Mark the true objects that some of the results contain and others do not, within 2 m.",
        rich_help_panel=OUTPUT,
    ),
]
RangeOption = Annotated[
    float,
    typer.Option(
        "--range",
        help="Range of the views from above, from the ego [m].",
        metavar="METRES",
        min=5,
        max=1000,
        rich_help_panel=OUTPUT,
    ),
]


def compare(
    arguments: NamesArgument,
    out: OutOption,
    frames: FrameOption = None,
    cameras: CameraOption = None,
    names: NameOption = None,
    min_score: MinScoreOption = 0.3,
    ellipses: EllipsesOption = False,
    range_m: RangeOption = 51.2,
    as_json: JsonOption = False,
) -> None:
    """Draw several results beside one ground truth: predictions blue, true boxes green.

    \b
    Example:
      duospacenet compare out/nano out/int8 synthetic:5:4 --out out/compared
    """
    from .. import jobs
    from ..jobs.compared_results import split_names

    results, sources = split_names(arguments)
    chosen: dict[str, Any] = {"frames": frames or (), "cameras": cameras or (), "names": names or ()}
    chosen |= {"min_score": min_score, "ellipses": ellipses, "range_m": range_m}
    pictures = jobs.compare(results, sources, out, progress=show_progress, **chosen)
    if as_json:
        print_json(pictures.to_dict())
    else:
        count = f"{len(pictures.names)} results, {len(pictures.frames)} frames"
        print_result(f"{count}; pictures in {pictures.out}", markup=False, soft_wrap=True)
