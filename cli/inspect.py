"""`duospacenet inspect`: the contents of a bundle, or the size of a model."""

from pathlib import Path
from typing import Annotated

import typer

from .console import print_json, show_progress
from .options import BEHAVIOUR, INPUT, OUTPUT, ConfigOption, JsonOption, PresetOption

BundleArgument = Annotated[
    Path | None, typer.Argument(help="Folder of a bundle.", metavar="BUNDLE", rich_help_panel=INPUT)
]
ComplexityOption = Annotated[
    bool, typer.Option("--complexity", help="Print parameters and FLOPs by part instead.", rich_help_panel=OUTPUT)
]
FramesOption = Annotated[
    int | None,
    typer.Option(
        help="With --complexity: number of frames in the temporal window. Default: 1.",
        min=1,
        metavar="N",
        rich_help_panel=BEHAVIOUR,
    ),
]

VerifyOption = Annotated[
    bool,
    typer.Option(
        "--verify",
        help="Also run the golden example of the bundle with onnxruntime, and compare. Exit code 1 if it differs.",
        rich_help_panel=BEHAVIOUR,
    ),
]


def inspect(
    bundle: BundleArgument = None,
    preset: PresetOption = None,
    config: ConfigOption = None,
    complexity: ComplexityOption = False,
    frames: FramesOption = None,
    verify: VerifyOption = False,
    as_json: JsonOption = False,
) -> None:
    """Print the contents of a bundle and check its files, or count a model's parameters and FLOPs.

    \b
    Examples:
      duospacenet inspect out/bundle
      duospacenet inspect out/bundle --verify
      duospacenet inspect --preset base --complexity
    """
    from ..jobs.inspection import inspect_bundle

    _check_options(bundle, preset, config, complexity, frames, verify)
    if bundle is None or complexity:
        _count_complexity(bundle, preset, config, frames or 1, as_json)
        return
    if verify:
        _verify(bundle, as_json)
        return
    manifest = inspect_bundle(bundle)
    if as_json:
        print_json(manifest.model_dump(mode="json"))
    else:
        from .manifest_table import print_manifest

        print_manifest(bundle, manifest)


def _verify(bundle: Path, as_json: bool) -> None:
    from ..jobs.golden_check import check_golden_example
    from .golden_table import print_golden_check

    check = check_golden_example(bundle, progress=show_progress)
    if as_json:
        print_json(check.to_dict())
    else:
        print_golden_check(check)
    if not check.passed:
        raise typer.Exit(1)


def _count_complexity(
    bundle: Path | None, preset: str | None, config: Path | None, num_frames: int, as_json: bool
) -> None:
    from ..jobs.inspection import inspect_bundle
    from ..jobs.models import bundle_config, choose_config
    from .complexity_table import print_complexity

    model = choose_config(preset, config) if bundle is None else bundle_config(bundle, inspect_bundle(bundle))
    print_complexity(model, num_frames, as_json)


def _check_options(
    bundle: Path | None,
    preset: str | None,
    config: Path | None,
    complexity: bool,
    frames: int | None,
    verify: bool,
) -> None:
    """Check that the options name exactly one bundle or model. Raises UsageError."""
    from ..runtime.errors import UsageError

    no_model = preset is None and config is None
    if (bundle is None) == no_model:
        got = "neither" if bundle is None else "both"
        raise UsageError(f"inspect: expected either BUNDLE, or --preset or --config with --complexity; got {got}.")
    if not no_model and not complexity:
        option = "--config" if preset is None else "--preset"
        raise UsageError(f"{option}: expected with --complexity; a configuration alone has no files to inspect.")
    if verify and (bundle is None or complexity):
        raise UsageError("--verify: expected with a bundle and without --complexity. Leave --verify out.")
    if frames is not None and not complexity:
        raise UsageError("--frames: expected only with --complexity. Leave --frames out.")
