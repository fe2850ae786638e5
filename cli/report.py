"""The parity report as tables."""

from rich.table import Table

from ..runtime.proof import Number, Proof, TensorRecord
from .console import results


def print_parity(proof: Proof) -> None:
    """Print a report as the manifest holds it."""
    results.print(_graph_table(proof))
    results.print(_stream_table(proof))
    for failure in proof.failures:
        results.print(f"[red]differs[/red] {failure}")
    results.print(f"inputs that no output depends on: {', '.join(proof.dead_inputs) or 'none'}")
    verdict = "[green]equal[/green]" if proof.passed else "[red]not equal[/red]"
    results.print(f"{verdict} to eager mode over {proof.frames} frames of {proof.source}")


def _graph_table(proof: Proof) -> Table:
    """The largest errors, a line an output; the memory values of a graph share a line, the worst of them."""
    title = f"each graph on eager's inputs, tolerance {proof.tolerances.graph:g} of the RMS"
    table = Table(title=title, title_justify="left")
    for column in ("graph", "output", "absolute", "relative to RMS", "1 - cosine"):
        table.add_column(column, justify="left" if column in ("graph", "output") else "right")
    for graph, outputs in proof.graphs.items():
        for name, error in _merge_memory(outputs).items():
            numbers = [error.absolute, error.relative, 1 - error.cosine]
            table.add_row(graph, name, *map(_number, numbers))
    return table


def _merge_memory(outputs: dict[str, TensorRecord]) -> dict[str, TensorRecord]:
    merged: dict[str, TensorRecord] = {}
    for name, error in outputs.items():
        kind = name.split("_value_")[0] + "_value_*" if "_value_" in name else name
        if kind not in merged or _size(error.relative) > _size(merged[kind].relative):
            merged[kind] = error
    return merged


def _stream_table(proof: Proof) -> Table:
    limits = proof.tolerances
    title = f"streamed, tolerance {limits.box:g} m, rad, m/s and {limits.score:g} in score"
    table = Table(title=title, title_justify="left")
    for column in ("frame", "window", "boxes", "unmatched", "box", "score", "map probability"):
        table.add_column(column, justify="right")
    for index, error in enumerate(proof.stream):
        numbers = [error.window, error.boxes, error.unmatched, error.box, error.score, error.map]
        table.add_row(str(index), *map(_number, numbers))
    return table


def _number(value: Number | int) -> str:
    if value is None:
        return "not finite"
    return str(value) if isinstance(value, int) else f"{value:.1e}"


def _size(value: Number) -> float:
    return float("inf") if value is None else value
