"""`duospacenet anchors`: where the object queries start, from the true boxes of a source."""

from pathlib import Path
from typing import Annotated

import typer

from ..runtime.anchors import (
    RANGE_M,
    SCHEMA_VERSION,
    Anchors,
    check_free,
    cluster,
    true_centres,
    within_range,
    write_anchors,
)
from ..runtime.sources import open_source
from .console import print_json, results, say, track

LARGEST_SEED = 2**31 - 1  # of OpenCV's generator

RangeOption = Annotated[
    float, typer.Option("--range", help="Leave out boxes farther from the ego [m].", min=1, max=1000)
]


def anchors(
    source: Annotated[str, typer.Argument(help="synthetic:SEED[:FRAMES], or a scene folder with true boxes.")],
    queries: Annotated[int, typer.Option(help="How many anchors: the queries of the preset.", min=1)],
    out: Annotated[Path, typer.Option(help="The file to write; must not exist yet.")],
    range_m: RangeOption = RANGE_M,
    seed: Annotated[int, typer.Option(help="Seed of the clustering.", min=0, max=LARGEST_SEED)] = 0,
    as_json: Annotated[bool, typer.Option("--json", help="The summary as one JSON object.")] = False,
) -> None:
    """Write the K-means centroids of the true boxes' centres, in the ego frame, for `export --anchors`."""
    check_free(out)
    opened = open_source(source)
    centres = list(true_centres(opened, track(range(len(opened)), "reading boxes")))
    points = within_range(centres, queries, range_m)
    say(f"clustering {len(points)} boxes ...")
    clusters = cluster(points, queries, seed)
    record = Anchors(
        schema_version=SCHEMA_VERSION,
        centres_m=clusters.centroids.tolist(),
        source=opened.identity,
        num_frames=len(centres),
        num_boxes=len(points),
        range_m=range_m,
        seed=seed,
    )
    write_anchors(out, record)
    facts = {"queries": queries, "boxes": len(points), "frames": len(centres), "distance_m": clusters.distance_m}
    if as_json:
        print_json({"anchors": str(out)} | facts)
    else:
        results.print(
            f"wrote {out}: {queries} anchors of {len(points)} boxes in {len(centres)} frames, "
            f"{clusters.distance_m:.2f} m from a box to its anchor (RMS)",
            markup=False,
            soft_wrap=True,
        )
