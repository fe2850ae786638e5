"""The parity report as tables, and the result of a bisection as text."""

from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from ..runtime.bundle.parity_report import Number, ParityReport, RetraceRecord, TensorErrorRecord
from .console import print_result

if TYPE_CHECKING:
    from ..export import Bisection

_MAX_OTHERS = 6  # further tensors that are named
_BISECTION_RESULTS = {
    "none": "no output differs, there is nothing to find",
    "tensor": "{graph}.onnx, {case}: the first tensor with a wrong value is {tensor}",
    "trace": "{graph}, {case}: the traced model computes another {tensor} than the model itself. The tracer "
    "recorded a constant where an input is needed: look at the model, not at the bundle",
    "optimiser": "{graph}.onnx, {case}: every tensor alone is correct, and {tensor} is correct without "
    "onnxruntime's optimiser. The optimiser causes the difference",
    "rounding": "{graph}.onnx, {case}: every tensor alone is correct, but small errors add up. The largest "
    "error is in {tensor}",
    "input": "{graph}.onnx: all outputs are equal, but {tensor}, disturbed by itself, changes them differently",
    "stream input": "every graph alone is correct. In frame {frame}, the first frame of the stream that differs, the "
    "pipeline passed {graph} another {tensor} than eager mode",
    "stream output": "every graph alone is correct, and its inputs in frame {frame}, the first frame of the stream "
    "that differs, are correct too. Look at the code after the graphs: selection, names, maps",
    "operator": "no output differs by more than the tolerance, but a new export of the model has other operators",
    "constant": "no output differs by more than the tolerance, but constants of the graphs are not the model's weights",
    "manifest": "the graphs are right, but manifest.json does not describe this model",
}


def print_parity(report: ParityReport, engine: str = "onnxruntime") -> None:
    """Print a parity report. engine: the library that ran the graphs."""
    print_result(_graph_table(report))
    print_result(_stream_table(report))
    for failure in report.failures:
        print_result(f"[red]differs[/red] {escape(failure)}", soft_wrap=True)
    for name, text in _coverage(report).items():
        print_result(f"{name:<16} {escape(text)}", soft_wrap=True)
    print_result(f"{_verdict(report)}; {engine}, {report.frames} frames: {escape(report.source)}")


def _verdict(report: ParityReport) -> str:
    reference = escape(report.reference or "eager mode")
    if not report.passed:
        return f"[red]not equal[/red] to {reference}: {len(report.failures)} differences above"
    if report.tolerances.quantized:
        return f"[green]within the tolerances of int8[/green] of {reference} in all that is listed above"
    return f"[green]equal[/green] to {reference} in all that is listed above"


def _coverage(report: ParityReport) -> dict[str, str]:
    """What the check exercised, in words, by kind. A report of an older schema does not tell."""
    coverage, weights = report.coverage, report.weights
    if coverage is None:
        return {}
    motion = {kind.rpartition("_"): size for kind, size in coverage.motion.items()}
    return {
        "windows": ", ".join(f"{count} frames of length {size}" for size, count in coverage.windows.items()),
        "lost cameras": ", ".join(f"{count} in slot {slot}" for slot, count in enumerate(coverage.lost_cameras)),
        "ego motion": ", ".join(f"{name} {size:.2g} {unit}" for (name, _, unit), size in motion.items()),
        "resets": ", ".join(f"{count} by {reason}" for reason, count in coverage.resets.items()),
        "other events": f"{coverage.calibrations} calibrations, {coverage.dropped_frames} after a dropped frame, "
        f"{coverage.skipped} without any image",
        "random inputs": ", ".join(f"{count} of {graph}" for graph, count in report.random_inputs.items()) or "none",
        "single elements": ", ".join(
            f"{report.elements[graph]} of {graph}"
            if graph in report.elements
            else f"none of {graph}, because its outputs differ already"
            for graph in report.random_inputs
        )
        or "none",
        "weights": f"{weights.matched} of {weights.parameters} tensors found in the graphs by value, "
        f"{weights.matched_values} of {weights.values} numbers"
        if weights
        else "not compared",
        "new export": _describe_retrace(report.retrace),
    }


def _describe_retrace(retrace: RetraceRecord | None) -> str:
    if retrace is None or retrace.skipped:
        return f"not compared{': ' + retrace.skipped if retrace and retrace.skipped else ''}"
    return f"operators and constants of {', '.join(retrace.graphs)} compared"


def print_bisection(bisection: "Bisection") -> None:
    """Print the first place where a bundle differs from the model, with details."""
    result = _BISECTION_RESULTS[bisection.kind].format(**vars(bisection), case=bisection.case)
    print_result(f"[bold]bisection[/bold] {escape(result)}")
    for name, text in _details(bisection).items():
        if text:
            print_result(f"  {name:<13} {escape(text)}", soft_wrap=True)


def _details(bisection: "Bisection") -> dict[str, str]:
    error, num_more = bisection.error, len(bisection.others) - _MAX_OTHERS
    counts = f"{bisection.num_off} of {bisection.num_compared} tensors differ, each computed from eager mode's values"
    more = f" and {num_more} more" if num_more > 0 else ""
    return {
        "operators": ", ".join(bisection.operators),
        "module": bisection.module,
        "source": bisection.source,
        "error": f"relative {error.relative:.2g}, absolute {error.absolute:.2g}" if error else "",
        "inputs": f"{', '.join(bisection.reads)} (equal to eager mode)" if bisection.reads else "",
        "cause": "; ".join(bisection.remarks),
        "compared": counts if bisection.num_compared else "",
        "also differ": ", ".join(bisection.others[:_MAX_OTHERS]) + more,
    }


def _graph_table(report: ParityReport) -> Table:
    """The largest errors, one row per output. A graph's cached values share one row, with the largest error."""
    limits = report.tolerances
    title = f"each graph with {'eager mode' if report.reference is None else 'the reference'}'s inputs, tolerance "
    title += f"{limits.graph:g} of the RMS"
    title += f"; of quantized graphs, RMS error {limits.quantized.graph:g}" if limits.quantized else ""
    table = Table(title=title, title_justify="left")
    columns = ["absolute", "relative to RMS", "1 - cosine", *(["RMS error"] if limits.quantized else [])]
    for column in ("graph", "output", *columns):
        table.add_column(column, justify="left" if column in ("graph", "output") else "right")
    for graph, outputs in report.graphs.items():
        for name, error in _merge_cached_values(outputs).items():
            numbers = [error.absolute, error.relative, 1 - error.cosine, *([error.rms] if limits.quantized else [])]
            table.add_row(graph, name, *map(_number, numbers))
    return table


def _merge_cached_values(outputs: dict[str, TensorErrorRecord]) -> dict[str, TensorErrorRecord]:
    merged: dict[str, TensorErrorRecord] = {}
    for name, error in outputs.items():
        kind = name.split("_value_")[0] + "_value_*" if "_value_" in name else name
        if kind not in merged or _judged(error) > _judged(merged[kind]):
            merged[kind] = error
    return merged


def _judged(error: TensorErrorRecord) -> float:
    """The number that is compared with the tolerance."""
    return _size(error.rms if error.quantized else error.relative)


def _stream_table(report: ParityReport) -> Table:
    limits = report.tolerances
    title = f"streamed, tolerance {limits.box:g} m, rad, m/s and {limits.score:g} in score"
    errors = {"box": "box", "score": "score", "map probability": "map"}
    if means := limits.quantized:
        title = f"streamed, tolerance of the means {means.position_m:g} m, {means.score:g} of the scores, {means.map:g}"
        errors = {"position [m]": "mean_position_m", "score": "mean_score", "map probability": "mean_map"}
    table = Table(title=title, title_justify="left")
    for column in ("frame", "window", "boxes", "unmatched", *errors):
        table.add_column(column, justify="right")
    for index, error in enumerate(report.stream):
        numbers = [error.window, error.boxes, error.unmatched, *(getattr(error, name) for name in errors.values())]
        table.add_row(str(index), *map(_number, numbers))
    return table


def _number(value: Number | int) -> str:
    if value is None:
        return "not finite"
    return str(value) if isinstance(value, int) else f"{value:.1e}"


def _size(value: Number) -> float:
    return float("inf") if value is None else value
