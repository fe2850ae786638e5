"""Print which check catches which seeded fault (`make faults`).

The exit code is 1 if a fault is missed, or if a check fails without a fault.
"""

import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tests.faults.catalogue import FAULTS, NO_FAULT, Fault, Trial, build_tiny_model, try_fault
from tests.helpers.exports import export_with_traces

WIDTH = 220  # wide enough for all columns, whatever the terminal's width
CHECKS = ("graphs", "stream", "elements", "weights", "manifest", "golden")


def main() -> int:
    console, messages = Console(highlight=False, width=WIDTH), Console(stderr=True, highlight=False)
    model = build_tiny_model()
    with tempfile.TemporaryDirectory() as folder:
        messages.print("exporting tiny ...")
        traces = export_with_traces(model, Path(folder) / "tiny")
        start_s = time.monotonic()
        trials = [
            try_fault(fault, Path(folder) / "tiny", model, traces if _is_bisected(fault) else None)
            for fault in (NO_FAULT, *FAULTS)
        ]
        messages.print(f"{len(FAULTS)} faults in {time.monotonic() - start_s:.0f} s")
    control, trials = trials[0], trials[1:]
    console.print(_table(trials))
    missed = [trial.fault.name for trial in trials if not trial.is_caught]
    console.print(
        f"{len(trials) - len(missed)} of {len(trials)} faults are caught; missed: {', '.join(missed) or 'none'}"
    )
    console.print(f"without a fault: caught by {', '.join(control.caught_by) or 'none'}")
    return int(bool(missed or control.caught_by))


def _is_bisected(fault: Fault) -> bool:
    """Whether the fault is bisected: all stream faults, and some graph faults, because those take a second each."""
    return bool(fault.bisected) or fault.where in ("input", "history", "result")


def _table(trials: list[Trial]) -> Table:
    title = "which check catches which fault (hash: the hash check, before the fault updates the hash in the manifest)"
    table = Table(title=title, title_justify="left")
    for column in ("fault", "where", "hash", *CHECKS, "bisection, or failed golden cases"):
        table.add_column(column, justify="center" if column in CHECKS or column == "hash" else "left", no_wrap=True)
    for trial in trials:
        marks = ["x" if check in trial.caught_by else "" for check in CHECKS]
        hashed = "x" if trial.refused_before_rehash else ""
        table.add_row(trial.fault.name, trial.fault.where, hashed, *marks, escape(_explanation(trial)))
    return table


def _explanation(trial: Trial) -> str:
    found = trial.bisection
    if found is None:
        return ", ".join(name.replace("_", " ") for name in trial.golden)
    remark = f": {found.remarks[0]}" if found.remarks else ""
    return f"{found.kind} {found.place}{remark}"


if __name__ == "__main__":
    sys.exit(main())
