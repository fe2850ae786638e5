"""The parity report as tables."""

from typing import Any

from rich.table import Table

from .console import results


def print_parity(report: dict[str, Any]) -> None:
    """Print a report as `ParityReport.to_dict` and the manifest hold it."""
    results.print(_graph_table(report))
    results.print(_stream_table(report))
    for failure in report["failures"]:
        results.print(f"[red]differs[/red] {failure}")
    dead = report["dead_inputs"]
    results.print(f"inputs that no output depends on: {', '.join(dead) if dead else 'none'}")
    verdict = "[green]equal[/green]" if report["passed"] else "[red]not equal[/red]"
    results.print(f"{verdict} to eager mode over {report['frames']} frames of {report['source']}")


def _graph_table(report: dict[str, Any]) -> Table:
    """The largest errors, one line an output; the memory values of a graph share one line, the worst of them."""
    limit = report["tolerances"]["graph"]
    table = Table(title=f"each graph on eager's inputs, tolerance {limit:g} of the RMS", title_justify="left")
    for column in ("graph", "output", "absolute", "relative to RMS", "1 - cosine"):
        table.add_column(column, justify="left" if column in ("graph", "output") else "right")
    for graph, outputs in report["graphs"].items():
        for name, error in _merge_memory(outputs).items():
            numbers = [error["absolute"], error["relative"], 1 - error["cosine"]]
            table.add_row(graph, name, *map(_number, numbers))
    return table


def _merge_memory(outputs: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    merged: dict[str, dict[str, Any]] = {}
    for name, error in outputs.items():
        kind = name.split("_value_")[0] + "_value_*" if "_value_" in name else name
        if kind not in merged or _size(error["relative"]) > _size(merged[kind]["relative"]):
            merged[kind] = error
    return merged


def _stream_table(report: dict[str, Any]) -> Table:
    tolerances = report["tolerances"]
    title = f"streamed, tolerance {tolerances['box']:g} m, rad, m/s and {tolerances['score']:g} in score"
    table = Table(title=title, title_justify="left")
    columns = {
        "window": "window",
        "boxes": "boxes",
        "unmatched": "unmatched",
        "box": "box",
        "score": "score",
        "map": "map probability",
    }
    table.add_column("frame", justify="right")
    for title in columns.values():
        table.add_column(title, justify="right")
    for index, error in enumerate(report["stream"]):
        table.add_row(str(index), *(_number(error[key]) for key in columns))
    return table


def _number(value: float | int | None) -> str:
    if value is None:
        return "not finite"
    return str(value) if isinstance(value, int) else f"{value:.1e}"


def _size(value: float | None) -> float:
    return float("inf") if value is None else value
