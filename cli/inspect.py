"""`duospacenet inspect`: what is in a bundle, and how large a model is."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from ..jobs.models import bundle_config, find_preset
from ..runtime.bundle.consistency import check_consistency
from ..runtime.bundle.manifest import GraphSpec, Manifest, check_files, read_manifest
from ..runtime.errors import UsageError
from .checkpoint_table import summarise
from .complexity_table import show_complexity
from .console import print_json, print_result
from .parity_table import print_parity

TRAINED = {True: "trained", False: "not trained", None: "not said whether trained"}
FORMS = {"native": "deformable convolutions as DeformConv", "grid-sample": "deformable convolutions in GridSample"}


def inspect(
    bundle: Annotated[Path | None, typer.Argument(help="A bundle's folder.")] = None,
    preset: Annotated[str | None, typer.Option(help="A preset instead of a bundle, for --complexity.")] = None,
    complexity: Annotated[bool, typer.Option("--complexity", help="Parameters and FLOPs by part instead.")] = False,
    frames: Annotated[
        int | None, typer.Option(help="Of the window that --complexity counts; default: 1.", min=1)
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="What is shown, as one JSON object.")] = False,
) -> None:
    """Show a bundle's graphs, tensors, sizes, provenance and parity, and check its files; or how large a model is."""
    if (bundle is None) == (preset is None):
        got = "neither" if bundle is None else "both"
        raise UsageError(f"inspect: expected either BUNDLE or --preset PRESET; got {got}.")
    if preset is not None and not complexity:
        raise UsageError("--preset: expected with --complexity; a preset alone has no files to show.")
    if frames is not None and not complexity:
        raise UsageError("--frames: expected with --complexity alone, whose window it is. Leave it out.")
    if preset is not None:
        show_complexity(find_preset(preset), frames or 1, as_json)
    elif bundle is not None:
        _inspect_bundle(bundle, (frames or 1) if complexity else None, as_json)


def _inspect_bundle(bundle: Path, complexity_frames: int | None, as_json: bool) -> None:
    """What `inspect` shows of a bundle; the complexity of its model where a number of frames is given."""
    manifest = read_manifest(bundle)
    check_files(bundle, manifest)
    check_consistency(bundle, manifest)
    if complexity_frames is not None:
        show_complexity(bundle_config(bundle, manifest), complexity_frames, as_json)
    elif as_json:
        print_json(manifest.model_dump(mode="json"))
    else:
        _print(bundle, manifest)


def _print(bundle: Path, manifest: Manifest) -> None:
    _print_facts(manifest)
    print_result(_graph_table(bundle, manifest))
    for name, graph in manifest.graphs.items():
        print_result(_tensor_table(name, graph))
    if manifest.parity is None:
        print_result("[red]not proven[/red]: the bundle carries no parity report")
    else:
        print_parity(manifest.parity)


def _print_facts(manifest: Manifest) -> None:
    window, image = manifest.window, manifest.preprocessing
    weights = manifest.weights
    facts = {
        "preset": f"{manifest.preset}, {manifest.precision}",
        "weights": f"{weights.source}, {TRAINED[weights.trained]}, {weights.sha256[:12]}",
        "made with": ", ".join(f"{name} {version}" for name, version in manifest.versions.items()),
        "cameras": f"up to {manifest.num_cameras}, {image.width_px}x{image.height_px} px",
        "window": f"{window.num_frames} frames, at most {window.largest_time_delta_s:g} s apart",
        "classes": ", ".join(manifest.classes),
        "maps": ", ".join(manifest.map_classes) or "none",
    }
    if manifest.dcn is not None:
        facts["DCN"] = FORMS[manifest.dcn]
    for name, fact in facts.items():
        print_result(f"{name:<10} {fact}", markup=False)
        if name == "weights" and weights.anchors is not None:
            start = f"queries start from {weights.anchors.file}, {weights.anchors.sha256[:12]}"
            print_result(f"{'':<10} {start}", markup=False)
        if name == "weights" and weights.checkpoint is not None:
            for line in summarise(weights.checkpoint):
                print_result(f"{'':<10} {line}", markup=False)


def _graph_table(bundle: Path, manifest: Manifest) -> Table:
    table = Table("graph", "file", "MB", "sha256")
    for name, graph in manifest.graphs.items():
        size_mb = (bundle / graph.file).stat().st_size / 1e6
        table.add_row(name, escape(graph.file), f"{size_mb:.2f}", graph.sha256[:12])
    return table


def _tensor_table(name: str, graph: GraphSpec) -> Table:
    table = Table("", "tensor", "shape", "type", title=name, title_justify="left")
    for side, specs in (("in", graph.inputs), ("out", graph.outputs)):
        for spec in specs:
            table.add_row(side, escape(spec.name), "x".join(map(str, spec.shape)), spec.dtype)
    return table
