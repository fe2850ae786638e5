"""The contents of a bundle as text and tables."""

from pathlib import Path

from rich.markup import escape
from rich.table import Table

from ..jobs.checkpoint_summary import describe_checkpoint
from ..runtime.bundle.manifest import GraphSpec, Manifest, WeightsRecord
from ..runtime.printable import printable
from .console import print_result
from .parity_table import print_parity
from .quantization_table import print_quantization

_TRAINED = {True: "trained", False: "not trained", None: "unknown whether trained"}
_SEALED = "all files match; this does not prove who made them (see `duospacenet verify`)"
_NOT_SEALED = "all graphs match, but schema 1 has no hash of the manifest: it may have been edited"
_DCN_FORMS = {
    "native": "deformable convolutions as DeformConv",
    "grid-sample": "deformable convolutions as GridSample",
}
_ATTENTION_FORMS = {
    "compact": "samples a location only in the cameras that see it",
    "grid-sample": "samples every location in every camera",
}


def print_manifest(bundle: Path, manifest: Manifest) -> None:
    """Print a bundle's provenance, graphs, tensors and parity report."""
    _print_facts(manifest)
    if manifest.quantization is not None:
        print_quantization(manifest.quantization)
    print_result(_graph_table(bundle, manifest))
    for name, graph in manifest.graphs.items():
        print_result(_tensor_table(name, graph))
    if manifest.parity is None:
        print_result("[red]not proven[/red]: the bundle has no parity report")
    else:
        print_parity(manifest.parity)


def _print_facts(manifest: Manifest) -> None:
    window, image, weights = manifest.window, manifest.preprocessing, manifest.weights
    facts = {
        "preset": f"{manifest.preset}, {manifest.precision}",
        "weights": f"{weights.source}, {_TRAINED[weights.trained]}, {weights.sha256[:12]}",
        "made with": ", ".join(f"{name} {version}" for name, version in manifest.versions.items()),
        "cameras": f"up to {manifest.num_cameras}, {image.width_px}x{image.height_px} px",
        "window": f"{window.num_frames} frames, at most {window.largest_time_delta_s:g} s apart",
        "classes": ", ".join(manifest.classes),
        "maps": ", ".join(manifest.map_classes) or "none",
        "hashes": _NOT_SEALED if manifest.schema_version == 1 else _SEALED,
    }
    if opsets := {graph.opsets[""] for graph in manifest.graphs.values() if graph.opsets}:
        facts["operators"] = f"ONNX operator set {', '.join(map(str, sorted(opsets)))}"
    facts["attention"] = _ATTENTION_FORMS[manifest.attention]
    if manifest.dcn is not None:
        facts["DCN"] = _DCN_FORMS[manifest.dcn]
    for name, fact in facts.items():
        for index, line in enumerate([fact, *(_weights_details(weights) if name == "weights" else [])]):
            print_result(printable(f"{name if index == 0 else '':<10} {line}"), markup=False)


def _weights_details(weights: WeightsRecord) -> list[str]:
    """One line per fact about the anchors and the checkpoint."""
    anchors = weights.anchors
    lines = [] if anchors is None else [f"queries start at {anchors.file}, {anchors.sha256[:12]}"]
    return lines + ([] if weights.checkpoint is None else describe_checkpoint(weights.checkpoint))


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
