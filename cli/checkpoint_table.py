"""The report on how a checkpoint fits a model, as a table."""

from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from ..jobs.checkpoint_summary import LAYOUT_DESCRIPTIONS, describe_wrappers, group_names
from .console import print_result

if TYPE_CHECKING:
    from ..weights import CheckpointReport

_MAX_LISTED = 12  # more names are grouped


def print_checkpoint(report: "CheckpointReport", source: str) -> None:
    """Print how a checkpoint fits a model."""
    print_result(_table(report, source))
    for note in report.notes:
        print_result(f"note: {note}", markup=False, soft_wrap=True)
    if report.accepted:
        print_result(f"[green]accepted[/green]: {report.verdict}", soft_wrap=True)
        return
    print_result(f"[red]refused[/red]: {escape(report.verdict)}", soft_wrap=True)
    for line in report.advice:
        print_result(line, markup=False, soft_wrap=True)


def _table(report: "CheckpointReport", source: str) -> Table:
    title = f"{source}: {LAYOUT_DESCRIPTIONS[report.layout]}{describe_wrappers(report.wrappers)}"
    table = Table("", "", "tensors", title=escape(title), title_justify="left")
    table.columns[1].justify = "right"
    table.add_row("matched", str(len(report.matched)), group_names(report.matched))
    table.add_row("missing, allowed", str(len(report.allowed_missing)), group_names(report.allowed_missing))
    table.add_row("left out, --ignore", str(len(report.ignored)), escape(group_names(report.ignored)))
    for kind, tensors in report.faults.items():
        table.add_row(kind, str(len(tensors)), escape(_list_names(tensors)), style="red" if tensors else None)
    table.add_row("ignored", str(len(report.left_aside)), escape(group_names(report.left_aside)))
    return table


def _list_names(tensors: list[str]) -> str:
    """Every name if there are few, otherwise the first three and the groups of all."""
    if len(tensors) <= _MAX_LISTED:
        return "\n".join(tensors)
    rest = f"and {len(tensors) - 3} more (--json lists all). Groups:"
    return "\n".join([*tensors[:3], rest, group_names(tensors)])
