"""`duospacenet export`: weights in, a proven bundle out."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..jobs.models import build_model, find_preset, report_checkpoint_fit
from ..runtime.bundle.manifest import DeformableForm
from ..runtime.errors import ArtifactError, UsageError
from ..runtime.extras import needs_extra
from .checkpoint_table import print_checkpoint, summarise
from .console import peak_memory_gb, print_json, print_message, show_progress
from .options import AllowMissingOption, AnchorsOption, RandomOption, SeedOption, WeightsOption
from .parity_table import print_parity

if TYPE_CHECKING:
    from ..model import DuoSpaceNetConfig


def export(
    preset: Annotated[str, typer.Option(help="tiny, nano, small, base or large; or an ablation: small-pv, ...")],
    out: Annotated[Path | None, typer.Option(help="The bundle's folder; must not exist yet.")] = None,
    weights: WeightsOption = None,
    random_weights: RandomOption = False,
    seed: SeedOption = 0,
    allow_missing: AllowMissingOption = None,
    anchors: AnchorsOption = None,
    dcn: Annotated[
        DeformableForm,
        typer.Option(help="Deformable convolutions: as DeformConv, or in GridSample for engines that lack it."),
    ] = "native",
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print how --weights fits, and write nothing; exit code 4 if it does not.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="The report as one JSON object.")] = False,
) -> None:
    """Write a bundle and prove it equal to the model; fails, and writes nothing, when the proof does."""
    start_s = time.monotonic()
    config = find_preset(preset)
    if dcn != "native" and not config.is_deformable:
        raise UsageError(f"--dcn: expected a preset with deformable convolutions; {preset} has none. Leave it out.")
    if dry_run and anchors is not None:
        raise UsageError("--dry-run: expected without --anchors, for it looks into --weights alone. Leave it out.")
    if dry_run:
        raise typer.Exit(_survey(config, weights, random_weights, allow_missing, as_json))
    if out is None:
        raise UsageError("--out: expected the bundle's folder, or --dry-run; got neither.")
    with needs_extra("export"):
        from ..export.bundle import ParityError, check_free, export_bundle
    check_free(out)
    model, provenance = build_model(config, weights, random_weights, seed, allow_missing, anchors)
    for line in summarise(provenance.checkpoint) if provenance.checkpoint else ():
        print_message(f"{provenance.source}: {line}")
    try:
        report = export_bundle(model, out, provenance, show_progress, dcn).to_report()
    except ParityError as error:
        if as_json:
            print_json({"bundle": None, "parity": error.report.to_report().model_dump(mode="json")})
        raise
    if as_json:
        print_json({"bundle": str(out), "parity": report.model_dump(mode="json")})
    else:
        print_parity(report)
        typer.echo(f"wrote {out} in {time.monotonic() - start_s:.0f} s, {peak_memory_gb():.1f} GB at the most")


def _survey(
    config: "DuoSpaceNetConfig",
    weights: Path | None,
    random_weights: bool,
    allow_missing: list[str] | None,
    as_json: bool,
) -> int:
    """Print how a checkpoint fits; returns the exit code."""
    if weights is None or random_weights:
        raise UsageError("--dry-run: expected --weights FILE, the checkpoint to look into.")
    report = report_checkpoint_fit(config, weights, allow_missing)
    if as_json:
        print_json({"checkpoint": weights.name} | report.to_dict())
    else:
        print_checkpoint(report, weights.name)
    return 0 if report.accepted else ArtifactError.exit_code
