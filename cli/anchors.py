"""`duospacenet anchors`: cluster the true boxes of sources into initial query positions."""

import os
from pathlib import Path
from typing import Annotated, Any

import typer

from .console import print_json, print_message, print_result, show_progress
from .options import ADVANCED, BEHAVIOUR, INPUT, OUTPUT, JsonOption

SourcesArgument = Annotated[
    list[str],
    typer.Argument(
        help="Sources with true boxes: scene folders, trusted:FOLDER, nuscenes:ROOT[@VERSION][/SPLIT] or "
        "synthetic:SEED[:FRAMES].",
        metavar="SOURCE",
        rich_help_panel=INPUT,
    ),
]
QueriesOption = Annotated[
    int,
    typer.Option(
        help="Number of anchors: the model's number of queries.",
        min=1,
        show_default=False,
        metavar="N",
        rich_help_panel=BEHAVIOUR,
    ),
]
OutOption = Annotated[
    str, typer.Option(help="New file to write.", metavar="FILE", show_default=False, rich_help_panel=OUTPUT)
]
RangeOption = Annotated[
    float,
    typer.Option(
        "--range",
        help="Leave out boxes farther from the ego, in metres.",
        min=1,
        max=1000,
        metavar="METRES",
        rich_help_panel=BEHAVIOUR,
    ),
]
ClassOption = Annotated[
    list[str] | None,
    typer.Option(
        "--class",
        help="A class of the model; repeat the option for each. [default: the ten classes of nuScenes]",
        metavar="NAME",
        show_default=False,
        rich_help_panel=ADVANCED,
    ),
]
SeedOption = Annotated[
    int, typer.Option(help="Seed of the clustering.", min=0, max=2**31 - 1, metavar="N", rich_help_panel=ADVANCED)
]


def anchors(
    sources: SourcesArgument,
    queries: QueriesOption,
    out: OutOption,
    range_m: RangeOption = 55.0,
    seed: SeedOption = 0,
    classes: ClassOption = None,
    as_json: JsonOption = False,
) -> None:
    """Write the K-means centroids of the true boxes' centres, in the ego frame, for `train` and `export`.

    \b
    Example:
      duospacenet anchors my_scene --queries 900 --out anchors.json
    """
    from .. import jobs

    file = _file_path(out)
    model: dict[str, Any] = {"classes": classes} if classes else {}
    callbacks: dict[str, Any] = {"progress": show_progress, "notify": print_message}
    summary = jobs.cluster_anchors(sources, queries, file, range_m=range_m, seed=seed, **model, **callbacks)
    if as_json:
        print_json(summary.to_dict())
        return
    frames = f"{summary.num_frames} frame{'' if summary.num_frames == 1 else 's'}"
    text = (
        f"wrote {file}: {queries} anchors from {summary.num_boxes} boxes in {frames}; "
        f"RMS distance from a box to its anchor: {summary.rms_distance_m:.2f} m"
    )
    print_result(text, markup=False, soft_wrap=True)


def _file_path(name: str) -> Path:
    """The path of a file, given as text because `Path` drops a trailing slash. Raises UsageError for a folder."""
    from ..runtime.errors import UsageError

    if name.rpartition(os.sep)[2] in ("", ".", ".."):
        raise UsageError(f"--out: expected a file name; got {name!r}. Choose a file, such as anchors.json.")
    return Path(name)
