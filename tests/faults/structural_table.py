"""Print which structural faults the `parity` command catches, and that bundles without a fault pass (`make faults`).

The arguments are the number of faults, by default 30, and the first seed, by default 0. The exit code is 1 if the
command misses a fault or fails without one.
"""

import contextlib
import io
import sys
import tempfile
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from duospacenet.cli.main import run_app
from tests.faults import compound_faults
from tests.faults.parity_command import Verdict, judge, run_parity
from tests.faults.structural_faults import StructuralFault, structural_fault

WIDTH = 320  # wide enough for all columns, whatever the terminal's width
CLEAN_EXPORTS = 10
COMPOUND = (
    StructuralFault("masks, ego motion and classes", "compound", compound_faults.masks_motion_and_classes),
    StructuralFault("perception and window limits", "compound", compound_faults.window_of_one_frame),
)


def main(num_faults: int = 30, first_seed: int = 0) -> int:
    console, messages = Console(highlight=False, width=WIDTH), Console(stderr=True, highlight=False)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bundle = _export(folder, seed=0)
        faults = [structural_fault(seed, bundle) for seed in range(first_seed, first_seed + num_faults)]
        faults += COMPOUND
        verdicts = []
        for fault in faults:
            messages.print(escape(fault.name))
            verdicts.append(judge(bundle, fault.inject, folder / "faulty"))
        console.print(_table(faults, verdicts))
        missed = [fault.name for fault, verdict in zip(faults, verdicts, strict=True) if not verdict.is_caught]
        by_others = sum(verdict.is_caught_without_new_export for verdict in verdicts)
        console.print(
            f"parity catches {len(faults) - len(missed)} of {len(faults)} faults, {by_others} of them without the "
            f"comparison with a new export; missed: {escape(', '.join(missed) or 'none')}"
        )
        seeds = range(1, 1 + CLEAN_EXPORTS)
        failed = [seed for seed in seeds if run_parity(_export(folder, seed), "--seed", str(seed)).exit_code]
    console.print(
        f"{len(seeds)} exports without a fault: {len(seeds) - len(failed)} pass; failed seeds: {failed or 'none'}"
    )
    return int(bool(missed or failed))


def _export(folder: Path, seed: int) -> Path:
    bundle = folder / f"bundle{seed}"
    command = ["export", "--preset", "tiny", "--random-weights", "--seed", str(seed), "--out", str(bundle)]
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        if run_app(command):
            raise SystemExit(f"the export with seed {seed} failed")
    return bundle


def _table(faults: list[StructuralFault], verdicts: list[Verdict]) -> Table:
    title = "structural faults, and the verdict of the parity command (1: differs, 4: not a valid bundle)"
    table = Table(title=title, title_justify="left")
    for column in ("fault", "kind", "exit code", "failures", "only by new export", "first failure"):
        table.add_column(column, justify="right" if column in ("exit code", "failures") else "left", no_wrap=True)
    for fault, verdict in zip(faults, verdicts, strict=True):
        first = verdict.failures[0] if verdict.failures else "MISSED"
        counts = str(verdict.exit_code), str(len(verdict.failures))
        only = "" if verdict.is_caught_without_new_export or not verdict.is_caught else "x"
        table.add_row(escape(fault.name), fault.kind, *counts, only, escape(first))
    return table


if __name__ == "__main__":
    sys.exit(main(*map(int, sys.argv[1:])))
