"""`duospacenet export`: export a model to a bundle, after checking that its graphs are equal to the model."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from .console import print_json, print_message, print_result, show_progress
from .options import (
    ADVANCED,
    BEHAVIOUR,
    OUTPUT,
    AllowMissingOption,
    AnchorsOption,
    ConfigOption,
    IgnoreOption,
    JsonOption,
    PresetOption,
    RandomOption,
    SeedOption,
    WeightsKeyOption,
    WeightsOption,
)

if TYPE_CHECKING:
    from ..model import DuoSpaceNetConfig

OutOption = Annotated[
    Path | None, typer.Option(help="New folder for the bundle.", metavar="FOLDER", rich_help_panel=OUTPUT)
]
DcnOption = Annotated[
    Literal["native", "grid-sample"],
    typer.Option(
        help="Operator of deformable convolutions: DeformConv, or GridSample for engines without it.",
        rich_help_panel=ADVANCED,
    ),
]
AttentionOption = Annotated[
    Literal["compact", "grid-sample"],
    typer.Option(
        help="Form of PV attention and lifting: compact samples visible locations only, grid-sample has static shapes.",
        rich_help_panel=ADVANCED,
    ),
]
OpsetOption = Annotated[
    int,
    typer.Option(
        help="Version of ONNX's operator set.",
        metavar="19|20|21|22",
        rich_help_panel=ADVANCED,
    ),
]
GoldenOption = Annotated[
    Path | None,
    typer.Option(
        "--golden",
        metavar="FILE",
        help="Also write inputs and outputs of PyTorch to this new .npz file, for `parity --golden` on machines "
        "without PyTorch.",
        rich_help_panel=OUTPUT,
    ),
]
DryRunOption = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        help="Only report how --weights fits the model. Exit code 4 if it does not fit.",
        rich_help_panel=BEHAVIOUR,
    ),
]


def export(
    out: OutOption = None,
    preset: PresetOption = None,
    config: ConfigOption = None,
    weights: WeightsOption = None,
    random_weights: RandomOption = False,
    seed: SeedOption = 0,
    allow_missing: AllowMissingOption = None,
    ignore: IgnoreOption = None,
    weights_key: WeightsKeyOption = None,
    anchors: AnchorsOption = None,
    dcn: DcnOption = "native",
    attention: AttentionOption = "compact",
    opset: OpsetOption = 19,
    golden: GoldenOption = None,
    dry_run: DryRunOption = False,
    as_json: JsonOption = False,
) -> None:
    """Export a model to ONNX graphs and compare them with PyTorch. If they differ, no bundle is written.

    Without --preset and --config, the configuration comes from the metadata of --weights.

    \b
    Example:
      duospacenet export --preset small --weights mine.pth --out out/bundle
    """
    from ..jobs.export_job import check_operators
    from ..jobs.models import choose_config

    chosen = choose_config(preset, config, weights)
    check_operators(chosen, dcn, opset)
    selection: dict[str, Any] = {"allow_missing": allow_missing, "ignore": ignore, "weights_key": weights_key}
    if dry_run:
        _check_dry_run(golden)
        raise typer.Exit(_report_fit(chosen, weights, random_weights, selection, anchors, as_json))
    forms = {"dcn": dcn, "attention": attention, "opset": opset, "golden": golden}
    _export(chosen, out, weights, random_weights, seed, selection, anchors, forms, as_json)


def _export(
    config: "DuoSpaceNetConfig",
    out: Path | None,
    weights: Path | None,
    random_weights: bool,
    seed: int,
    selection: dict[str, Any],
    anchors: Path | None,
    forms: dict[str, Any],
    as_json: bool,
) -> None:
    """Export, and print the parity report, also of an export that failed its parity check."""
    from .. import jobs
    from ..runtime.errors import UsageError
    from ..runtime.extras import needs_extra
    from ..runtime.peak_memory import peak_memory_gb
    from .parity_table import print_parity

    if out is None:
        raise UsageError("--out: expected a folder for the bundle, or --dry-run; got neither.")
    with needs_extra("export"):
        from ..export import ParityError
    start_s = time.monotonic()
    try:
        report = jobs.export_model(
            config,
            out,
            weights=weights,
            random_weights=random_weights,
            seed=seed,
            **selection,
            anchors=anchors,
            **forms,
            progress=show_progress,
            notify=print_message,
        )
    except ParityError as error:
        if as_json:
            print_json({"bundle": None, "parity": error.result.to_report().model_dump(mode="json")})
        raise
    if as_json:
        print_json({"bundle": str(out), "parity": report.model_dump(mode="json")})
    else:
        print_parity(report)
        text = f"wrote {out} in {time.monotonic() - start_s:.0f} s, peak memory {peak_memory_gb():.1f} GB"
        print_result(text, markup=False, soft_wrap=True)


def _check_dry_run(golden: Path | None) -> None:
    """Raise UsageError for an option that a dry run does not take."""
    from ..runtime.errors import UsageError

    if golden is not None:
        raise UsageError("--dry-run: expected without --golden, because nothing is exported. Leave one out.")


def _report_fit(
    config: "DuoSpaceNetConfig",
    weights: Path | None,
    random_weights: bool,
    selection: dict[str, Any],
    anchors: Path | None,
    as_json: bool,
) -> int:
    """Print how a checkpoint fits a configuration. Returns the exit code."""
    from ..jobs.models import report_checkpoint_fit
    from ..runtime.errors import ArtifactError, UsageError
    from .checkpoint_table import print_checkpoint

    if anchors is not None:
        raise UsageError("--dry-run: expected without --anchors, because only --weights are read. Leave one out.")
    if weights is None or random_weights:
        raise UsageError("--dry-run: expected --weights FILE, the checkpoint to report on.")
    report = report_checkpoint_fit(config, weights, **selection, notify=print_message)
    if as_json:
        print_json({"checkpoint": weights.name} | report.to_dict())
    else:
        print_checkpoint(report, weights.name)
    return 0 if report.accepted else ArtifactError.exit_code
