"""`duospacenet export`: weights in, a proven bundle out."""

import time
from pathlib import Path
from typing import Annotated

import typer

from .console import needs_extra, peak_memory_gb, print_json, track
from .report import print_parity
from .weights import RandomOption, SeedOption, WeightsOption, build_model, find_preset


def export(
    preset: Annotated[str, typer.Option(help="Which DuoSpaceNet: tiny, nano or small.")],
    out: Annotated[Path, typer.Option(help="The bundle's folder; must not exist yet.")],
    weights: WeightsOption = None,
    random_weights: RandomOption = False,
    seed: SeedOption = 0,
    as_json: Annotated[bool, typer.Option("--json", help="The parity report as one JSON object.")] = False,
) -> None:
    """Write a bundle and prove it equal to the model; fails, and writes nothing, when the proof does."""
    start_s = time.monotonic()
    config = find_preset(preset)
    with needs_extra("export"):
        from ..export.bundle import ParityError, check_free, export_bundle
    check_free(out)
    model, provenance = build_model(config, weights, random_weights, seed)
    try:
        report = export_bundle(model, out, provenance, track).to_proof()
    except ParityError as error:
        if as_json:
            print_json({"bundle": None, "parity": error.report.to_proof().model_dump(mode="json")})
        raise
    if as_json:
        print_json({"bundle": str(out), "parity": report.model_dump(mode="json")})
    else:
        print_parity(report)
        typer.echo(f"wrote {out} in {time.monotonic() - start_s:.0f} s, {peak_memory_gb():.1f} GB at the most")
