"""The summary of a run as text and a table."""

from typing import TYPE_CHECKING

from rich.table import Table

from .console import print_result

if TYPE_CHECKING:
    from ..jobs.inference import RunSummary


def print_run(summary: "RunSummary") -> None:
    """Print the median time of each stage and the counts of a run."""
    if summary.median_ms:  # empty if a resumed run had no frames left
        table = Table("stage", "median ms")
        for stage, milliseconds in summary.median_ms.items():
            table.add_row(stage, f"{milliseconds:.1f}")
        print_result(table)
    incomplete = {"skipped": summary.skipped, "degraded": summary.degraded}
    notes = "".join(f" ({number} {kind})" for kind, number in incomplete.items() if number)
    counts = f"{summary.frames} frames{notes}, {summary.boxes} boxes, peak memory {summary.peak_memory_gb:.1f} GB"
    engine, precision = "{name} {version}".format(**summary.engine), summary.engine["precision"]
    engine += "" if precision == "float32" else f" in {precision}"
    print_result(f"{counts}; {engine}; results in {summary.out}", markup=False)
