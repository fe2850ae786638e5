"""The parity report as tables, and a bisection in words."""

from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from ..runtime.bundle.parity_report import Number, ParityReport, TensorErrorRecord
from .console import print_result

if TYPE_CHECKING:
    from ..export import Bisection

_OTHERS_SHOWN = 6
_HEADLINES = {
    "none": "nothing to find, parity holds",
    "tensor": "{graph}.onnx, frame {frame}: the first tensor that is computed wrongly is {tensor}",
    "trace": "{graph}, frame {frame}: the model gives another {tensor} when it is traced than when it runs. What "
    "should be an input is a constant to the tracer: look at the model, not at the bundle",
    "optimiser": "{graph}.onnx, frame {frame}: every tensor is right by itself, and so is {tensor} as long as "
    "onnxruntime fuses nothing. Its optimiser makes the difference",
    "rounding": "{graph}.onnx, frame {frame}: every tensor is right by itself, but small errors add up. The largest "
    "is in {tensor}",
    "dead input": "{graph}.onnx: no output depends on the input {tensor}",
    "stream input": "every graph is right by itself; in frame {frame}, the first that is off in the stream, the "
    "pipeline fed {graph} with another {tensor} than eager mode",
    "stream output": "every graph is right by itself, and was fed rightly in frame {frame}, the first that is off in "
    "the stream. Look at what is made of the graphs' outputs: selection, names, maps",
}


def print_parity(proof: ParityReport) -> None:
    """Print a report as the manifest holds it."""
    print_result(_graph_table(proof))
    print_result(_stream_table(proof))
    for failure in proof.failures:
        print_result(f"[red]differs[/red] {escape(failure)}")
    print_result(f"inputs that no output depends on: {escape(', '.join(proof.dead_inputs)) or 'none'}")
    verdict = "[green]equal[/green]" if proof.passed else "[red]not equal[/red]"
    print_result(f"{verdict} to eager mode over {proof.frames} frames of {escape(proof.source)}")


def print_bisection(found: "Bisection") -> None:
    """Print where a bundle leaves the model, and what is known about it."""
    print_result(f"[bold]bisection[/bold] {escape(_HEADLINES[found.kind].format(**vars(found)))}")
    for what, text in _details(found).items():
        if text:
            print_result(f"  {what:<13} {escape(text)}", soft_wrap=True)


def _details(found: "Bisection") -> dict[str, str]:
    error, more = found.error, len(found.others) - _OTHERS_SHOWN
    counted = f"{found.num_off} of {found.num_compared} tensors are off, each computed from eager mode's own values"
    return {
        "operators": ", ".join(found.operators),
        "module": found.module,
        "source": found.source,
        "error": f"relative {error.relative:.2g}, absolute {error.absolute:.2g}" if error else "",
        "made of": f"{', '.join(found.reads)} (as in eager mode)" if found.reads else "",
        "cause": "; ".join(found.remarks),
        "compared": counted if found.num_compared else "",
        "off as well": ", ".join(found.others[:_OTHERS_SHOWN]) + (f" and {more} more" if more > 0 else ""),
    }


def _graph_table(proof: ParityReport) -> Table:
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


def _merge_memory(outputs: dict[str, TensorErrorRecord]) -> dict[str, TensorErrorRecord]:
    merged: dict[str, TensorErrorRecord] = {}
    for name, error in outputs.items():
        kind = name.split("_value_")[0] + "_value_*" if "_value_" in name else name
        if kind not in merged or _size(error.relative) > _size(merged[kind].relative):
            merged[kind] = error
    return merged


def _stream_table(proof: ParityReport) -> Table:
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
