"""Prints which check catches which seeded fault; ends with 1 when one is missed, or a check sees what is not there.

.venv/bin/python tests/faults/table.py
"""

import sys
import tempfile
import time
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from tests.faults.catalogue import FAULTS, HEALTHY, Fault, Trial, tiny_model, try_fault
from tests.helpers.exports import export_with_traces

WIDTH = 220  # so that no word is cut off, whatever the terminal
CHECKS = ("graphs", "stream", "liveness", "golden")


def main() -> int:
    console, messages = Console(highlight=False, width=WIDTH), Console(stderr=True, highlight=False)
    model = tiny_model()
    with tempfile.TemporaryDirectory() as folder:
        messages.print("exporting tiny ...")
        traces = export_with_traces(model, Path(folder) / "tiny")
        start_s = time.monotonic()
        trials = [
            try_fault(fault, Path(folder) / "tiny", model, traces if _is_bisected(fault) else None)
            for fault in (HEALTHY, *FAULTS)
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
    """Some faults of graphs, which take a second each, and all of streams."""
    return bool(fault.bisected) or fault.where in ("feed", "state", "answers")


def _table(trials: list[Trial]) -> Table:
    title = (
        "which check catches which fault (hash: of the file as it was found, before the fault's author corrected it)"
    )
    table = Table(title=title, title_justify="left")
    for column in ("fault", "where", "hash", *CHECKS, "what a bisection, or a golden case, says"):
        table.add_column(column, justify="center" if column in CHECKS or column == "hash" else "left", no_wrap=True)
    for trial in trials:
        marks = ["x" if check in trial.caught_by else "" for check in CHECKS]
        hashed = "x" if trial.is_refused_as_found else ""
        table.add_row(trial.fault.name, trial.fault.where, hashed, *marks, escape(_words(trial)))
    return table


def _words(trial: Trial) -> str:
    found = trial.bisection
    if found is None:
        return ", ".join(name.replace("_", " ") for name in trial.golden)
    remark = f": {found.remarks[0]}" if found.remarks else ""
    return f"{found.kind} {found.place}{remark}"


if __name__ == "__main__":
    sys.exit(main())
