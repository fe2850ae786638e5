"""`duospacenet parity`: prove a bundle again."""

from pathlib import Path
from typing import Annotated

import typer

from ..jobs.models import build_model, bundle_config, random_init_options
from ..jobs.sources import open_source
from ..runtime.bundle.manifest import WeightsRecord, read_manifest
from ..runtime.extras import needs_extra
from .console import print_json, print_message, show_progress
from .options import AllowMissingOption, AnchorsOption, RandomOption, WeightsOption
from .parity_table import print_bisection, print_parity


def parity(
    bundle: Annotated[Path, typer.Argument(help="A bundle's folder.")],
    weights: WeightsOption = None,
    random_weights: RandomOption = False,
    seed: Annotated[
        int | None,
        typer.Option(
            help="Seed of what is drawn at random; default: 0, or what completed the bundle's checkpoint.", min=0
        ),
    ] = None,
    allow_missing: AllowMissingOption = None,
    anchors: AnchorsOption = None,
    source: Annotated[
        str | None, typer.Option(help="Frames to compare on: synthetic:SEED[:FRAMES] or a scene folder.")
    ] = None,
    bisect: Annotated[
        bool, typer.Option("--bisect", help="Where they differ, find the first graph, and the first tensor in it.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="The report as one JSON object.")] = False,
) -> None:
    """Run the model in eager mode and the bundle side by side and compare; exit code 1 where they differ."""
    manifest = read_manifest(bundle)
    with needs_extra("export"):
        from ..export import bisect_parity, check_parity
    config = bundle_config(bundle, manifest)
    recorded = manifest.weights.checkpoint if weights is not None else None
    seed, allow_missing = random_init_options(recorded, seed, allow_missing)
    model, provenance = build_model(config, weights, random_weights, seed, allow_missing, anchors)
    if provenance.sha256 != manifest.weights.sha256:
        print_message(f"warning: the bundle was made from other weights, {_described(manifest.weights)}; these are of")
        print_message(f"         {_described(provenance)}")
    frames = None if source is None else list(show_progress(open_source(source), "reading"))
    report = check_parity(bundle, model, frames, source or "scripted drive", show_progress)
    found = bisect_parity(bundle, model, frames, report, show_progress) if bisect else None
    if as_json:
        print_json(report.to_report().model_dump(mode="json") | ({"bisection": found.to_dict()} if found else {}))
    else:
        print_parity(report.to_report())
        if found:
            print_bisection(found)
    if not report.passed:
        raise typer.Exit(1)


def _described(weights: WeightsRecord) -> str:
    anchors = weights.anchors
    start = f", queries from {anchors.file} ({anchors.sha256[:12]})" if anchors else ", without --anchors"
    return f"{weights.source} ({weights.sha256[:12]}){start}"
