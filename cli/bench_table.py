"""The result of a benchmark as tables."""

from typing import TYPE_CHECKING

from rich import box
from rich.markup import escape
from rich.table import Table

from .console import print_result

if TYPE_CHECKING:
    from ..jobs.benchmarking.bench_job import BenchResult
    from ..jobs.benchmarking.bench_report import BenchReport, OperatorRecord, Percentiles, TargetReport
    from ..jobs.benchmarking.regression import Comparison

_MAX_OPERATORS = 20


def print_bench(result: "BenchResult") -> None:
    """Print the report of a benchmark, and the comparison with an earlier one."""
    report = result.report
    for line in _machine_lines(report):
        print_result(line, markup=False, soft_wrap=True)
    print_result(_stage_table(report))
    for line in _bundle_lines(report):
        print_result(line, markup=False, soft_wrap=True)
    if report.alternatives:
        print_result(_alternative_table(report))
    if report.operators is not None:
        print_result(_operator_table(report.operators))
    for name, reason in report.skipped.items():
        print_result(f"{name} was not measured: {reason}", markup=False, soft_wrap=True)
    if result.comparison:
        _print_comparison(result.comparison)


def _machine_lines(report: "BenchReport") -> list[str]:
    machine, frames = report.machine, report.frames
    affinity = ",".join(map(str, machine.affinity)) or "unknown"
    load = "" if machine.load_average is None else f", load average before {machine.load_average:g}"
    versions = ", ".join(f"{name} {version}" for name, version in report.figures.versions.items())
    return [
        f"CPU: {machine.cpu}, {' '.join(machine.instruction_sets) or 'no known instruction set'}",
        f"{machine.threads} threads, cores {affinity}{load}; {machine.system}; {versions}",
        f"{report.bundle.path}: {report.figures.description}; maps {'on' if report.maps else 'off'}",
        f"{report.figures.queries} frames in {report.rounds} rounds, from {frames.distinct} frames of {frames.source}",
    ]


def _stage_table(report: "BenchReport") -> Table:
    table = _table("stage, ms", "p50", "p90", "p99", "p99.9", "share")
    total_ms = report.figures.frame_ms.p50
    for stage, percentiles in report.figures.stages_ms.items():
        table.add_row(stage, *_row(percentiles), f"{100 * percentiles.p50 / total_ms:.1f} %")
    table.add_section()
    table.add_row("frame", *_row(report.figures.frame_ms), "")
    return table


def _bundle_lines(report: "BenchReport") -> list[str]:
    figures, cold = report.figures, report.cold_start
    host_share = f"{100 * report.host_share:.1f} %"
    lines = [
        f"first frame of a stream {cold.first_frame_ms:.1f} ms, window of {cold.window} frames "
        f"{cold.full_window_ms:.1f} ms, ratio {cold.ratio:.3f}; pre- and postprocessing {host_share}",
        f"loading {figures.load_s:.2f} s, first frame after it {figures.first_frame_ms:.1f} ms; peak memory "
        f"{figures.peak_memory_gb:.2f} GB, of which {report.frames.megabytes / 1000:.2f} GB are the decoded frames",
    ]
    rates = [
        f"{record.streams} stream{'s' * (record.streams > 1)} {record.frames_per_s:.2f} frames/s "
        f"({record.peak_memory_gb:.2f} GB)"
        for record in report.throughput
    ]
    if rates:
        lines.append(f"throughput: {', '.join(rates)}")
    if report.interrupted:
        lines.append(f"interrupted: the figures are those of {report.rounds} complete rounds")
    return lines


def _alternative_table(report: "BenchReport") -> Table:
    table = _table("alternative", "median ms", "ratio", "quartiles", "load s", "memory GB")
    table.add_row("bundle", _ms(report.figures.frame_ms.p50), "1", "", *_load(report.figures))
    for name, target in report.alternatives.items():
        ratio = report.ratios[name]
        quartiles = f"{ratio.q1:.2f} to {ratio.q3:.2f}"
        table.add_row(escape(name), _ms(target.frame_ms.p50), f"{ratio.median:.2f}", quartiles, *_load(target))
    return table


def _operator_table(operators: "tuple[OperatorRecord, ...]") -> Table:
    table = _table("graph", "operator", "calls", "ms", "share")
    for record in operators[:_MAX_OPERATORS]:
        share = f"{100 * record.share:.1f} %"
        numbers = f"{record.calls_per_frame:g}", f"{record.ms_per_frame:.2f}", share
        table.add_row(escape(record.graph), escape(record.operator), *numbers)
    rest = operators[_MAX_OPERATORS:]
    if rest:
        rest_ms, rest_share = (sum(values) for values in zip(*((r.ms_per_frame, r.share) for r in rest), strict=True))
        table.add_row("others", f"{len(rest)} kinds", "", f"{rest_ms:.2f}", f"{100 * rest_share:.1f} %")
    return table


def _print_comparison(comparison: "Comparison") -> None:
    table = _table(f"against {escape(str(comparison.baseline))}", "before", "now", "slower by")
    for change in comparison.changes:
        colour = "red" if change in comparison.regressions else "default"
        slowdown = f"[{colour}]{100 * change.slowdown:+.1f} %[/{colour}]"
        table.add_row(escape(change.figure), f"{change.old:.4g}", f"{change.new:.4g}", slowdown)
    print_result(table)
    limit = f"{100 * comparison.max_regression:g} %"
    verdict = f"[green]no figure is slower by more than {limit}[/green]"
    if not comparison.passed:
        verdict = f"[red]{len(comparison.regressions)} figures are slower by more than {limit}[/red]"
    print_result(verdict)


def _table(*columns: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for index, column in enumerate(columns):
        is_text = index == 0 or column == "operator"
        table.add_column(column, justify="left" if is_text else "right", overflow="fold")
    return table


def _row(percentiles: "Percentiles") -> list[str]:
    values = percentiles.p50, percentiles.p90, percentiles.p99, percentiles.p99_9
    return ["-" if value is None else _ms(value) for value in values]


def _load(target: "TargetReport") -> tuple[str, str]:
    return f"{target.load_s:.2f}", f"{target.peak_memory_gb:.2f}"


def _ms(milliseconds: float) -> str:
    return f"{milliseconds:.1f}" if milliseconds >= 1 else f"{milliseconds:.2f}"
