"""The comparison of a benchmark with an earlier one: has the bundle become slower?

If both reports have an alternative in common, its ratio to the bundle is compared. Ratios hold on another or a busy
machine. Otherwise milliseconds are compared, which is only allowed on the same CPU.
"""

from collections.abc import Collection
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ...runtime.bundle.manifest import Manifest
from ...runtime.cpu import read_cpu
from ...runtime.errors import InputError, UsageError
from ...runtime.files import read_regular_file
from ...runtime.json_record import check_record, parse_json
from ..notify import Notify, ignore
from .bench_report import MAX_REPORT_BYTES, REPORT_KIND, REPORT_SCHEMA, BenchReport
from .targets import PEERS, Target

SMALLEST_SHARE = 0.05  # of the frame; shorter stages vary too much to be judged


@dataclass(frozen=True)
class Change:
    """A figure of both reports. slowdown: how much slower the new one is, as a share of the old; negative if faster."""

    figure: str
    old: float
    new: float
    slowdown: float


@dataclass(frozen=True)
class Comparison:
    """The figures that two reports have in common. max_regression: the largest permitted slowdown."""

    baseline: Path
    max_regression: float
    changes: tuple[Change, ...]

    @property
    def regressions(self) -> list[Change]:
        """The figures that became worse by more than the limit."""
        return [change for change in self.changes if change.slowdown > self.max_regression]

    @property
    def passed(self) -> bool:
        """Whether no figure became worse by more than the limit."""
        return not self.regressions

    def to_dict(self) -> dict[str, Any]:
        """The comparison as JSON values."""
        changes = [asdict(change) for change in self.changes]
        return {"max_regression": self.max_regression, "passed": self.passed, "changes": changes}


@dataclass(frozen=True)
class Baseline:
    """An earlier report and its file."""

    path: Path
    report: BenchReport


def read_baseline(path: Path) -> Baseline:
    """Read a report that `duospacenet bench --json` printed. Raises InputError for any other file."""
    values = parse_json(path, read_regular_file(path, MAX_REPORT_BYTES, InputError), InputError)
    if values.get("kind") != REPORT_KIND or values.get("schema_version") != REPORT_SCHEMA:
        raise InputError(
            f"{path}: expected a report of `duospacenet bench --json`, schema {REPORT_SCHEMA}; got another JSON "
            "object. Choose another --compare."
        )
    values.pop("comparison", None)
    return Baseline(path, check_record(path, values, BenchReport, InputError))


def check_baseline(
    baseline: Baseline, manifest: Manifest, target: Target, alternatives: Collection[str], notify: Notify = ignore
) -> None:
    """Check before the measurement that a comparison will be possible.

    notify: told if the report is of another machine, so that only ratios can be compared.

    Raises UsageError for the report of another preset, or of another CPU or number of threads if no ratio can be
    compared.
    """
    old = baseline.report
    if old.bundle.preset != manifest.preset:
        raise UsageError(
            f"--compare: expected a report of preset {manifest.preset!r}; {baseline.path} is of {old.bundle.preset!r}."
        )
    cpu = read_cpu()
    machine = _describe(cpu.model, cpu.instruction_sets, target.threads)
    old_machine = _describe(old.machine.cpu, old.machine.instruction_sets, old.machine.threads)
    if machine == old_machine:
        return
    difference = f"{baseline.path} was measured on another machine ({old_machine}; this one is {machine})"
    if any(name in PEERS and name in old.ratios for name in alternatives):
        notify(f"{difference}: only ratios are compared")
        return
    peers = ", ".join(name for name in old.ratios if name in PEERS) or "it has none"
    raise UsageError(
        f"--compare: {difference}. Milliseconds of two machines cannot be compared, but ratios can: add --against "
        f"with an alternative of that report ({peers})."
    )


def compare_reports(baseline: Baseline, new: BenchReport, max_regression: float) -> Comparison:
    """Compare the ratios that both reports have, or else their milliseconds and throughput."""
    old = baseline.report
    changes = _ratio_changes(old, new) or [*_duration_changes(old, new), *_throughput_changes(old, new)]
    return Comparison(baseline.path, max_regression, tuple(changes))


def _ratio_changes(old: BenchReport, new: BenchReport) -> list[Change]:
    """The ratios to the peers in both reports. Bundles of the same name may differ, so they are left out."""
    return [
        _change(f"{name} / bundle", old.ratios[name].median, new.ratios[name].median, higher_is_better=True)
        for name in PEERS
        if name in old.ratios and name in new.ratios
    ]


def _duration_changes(old: BenchReport, new: BenchReport) -> list[Change]:
    """The median frame, and the medians of the stages that matter."""
    old_ms, new_ms = old.figures.frame_ms.p50, new.figures.frame_ms.p50
    changes = [_change("frame, median ms", old_ms, new_ms)]
    for stage, percentiles in old.figures.stages_ms.items():
        if stage in new.figures.stages_ms and percentiles.p50 >= SMALLEST_SHARE * old_ms:
            changes.append(_change(f"{stage}, median ms", percentiles.p50, new.figures.stages_ms[stage].p50))
    return changes


def _throughput_changes(old: BenchReport, new: BenchReport) -> list[Change]:
    old_rates = {record.streams: record.frames_per_s for record in old.throughput}
    return [
        _change(f"{record.streams} streams, frames/s", old_rates[record.streams], record.frames_per_s, True)
        for record in new.throughput
        if record.streams in old_rates
    ]


def _change(figure: str, old: float, new: float, higher_is_better: bool = False) -> Change:
    slowdown = old / new - 1 if higher_is_better else new / old - 1
    return Change(figure, old, new, round(slowdown, 4))


def _describe(cpu: str, instruction_sets: Collection[str], threads: int) -> str:
    return f"{cpu}, {' '.join(instruction_sets) or 'no known instruction set'}, {threads} threads"
