"""`duospacenet anchors`: where the object queries start, from the true boxes of a source."""

import os
from pathlib import Path
from typing import Annotated

import typer

from ..data.anchor_clustering import DEFAULT_RANGE_M, centres_within_range, cluster_centres, ground_truth_centres
from ..data.anchors_file import LARGEST_RANGE_M, SCHEMA_VERSION, Anchors, check_new_file, write_anchors
from ..jobs.sources import open_source
from ..runtime.errors import UsageError
from .console import print_json, print_message, print_result, show_progress

LARGEST_SEED = 2**31 - 1  # of OpenCV's generator

RangeOption = Annotated[
    float,
    typer.Option("--range", help="Leave out boxes farther from the ego, in metres.", min=1, max=LARGEST_RANGE_M),
]


def anchors(
    source: Annotated[str, typer.Argument(help="synthetic:SEED[:FRAMES], or a scene folder with true boxes.")],
    queries: Annotated[int, typer.Option(help="How many anchors: the queries of the preset.", min=1)],
    out: Annotated[str, typer.Option(help="The file to write; must not exist yet.", metavar="PATH")],
    range_m: RangeOption = DEFAULT_RANGE_M,
    seed: Annotated[int, typer.Option(help="Seed of the clustering.", min=0, max=LARGEST_SEED)] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="The summary as one JSON object.")] = False,
) -> None:
    """Write the K-means centroids of the true boxes' centres, in the ego frame, for `export --anchors`."""
    file = _file_named(out)
    check_new_file(file)
    opened = open_source(source)
    centres = list(ground_truth_centres(opened, show_progress(range(len(opened)), "reading boxes")))
    points = centres_within_range(centres, queries, range_m)
    print_message(f"clustering {len(points)} boxes ...")
    clusters = cluster_centres(points, queries, seed)
    record = Anchors(
        schema_version=SCHEMA_VERSION,
        centres_m=clusters.centroids.tolist(),
        source=opened.identity,
        num_frames=len(centres),
        num_boxes=len(points),
        range_m=range_m,
        seed=seed,
    )
    write_anchors(file, record)
    facts = {"queries": queries, "boxes": len(points), "frames": len(centres), "distance_m": clusters.rms_distance_m}
    if as_json:
        print_json({"anchors": str(file)} | facts)
    else:
        print_result(
            f"wrote {file}: {queries} anchors of {len(points)} boxes "
            f"in {len(centres)} frame{'' if len(centres) == 1 else 's'}, "
            f"{clusters.rms_distance_m:.2f} m from a box to its anchor (RMS)",
            markup=False,
            soft_wrap=True,
        )


def _file_named(name: str) -> Path:
    """A name as it was typed, for `Path` forgets its last slash. Raises UsageError for a folder's, or none."""
    if name.rpartition(os.sep)[2] in ("", ".", ".."):
        raise UsageError(f"--out: expected the name of a file; got {name!r}. Name one, such as anchors.json.")
    return Path(name)
