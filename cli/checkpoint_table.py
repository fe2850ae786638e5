"""The report on a checkpoint as a table, and its record in a few lines."""

from collections import Counter
from collections.abc import Iterable
from typing import TYPE_CHECKING

from rich.markup import escape
from rich.table import Table

from ..runtime.bundle.manifest import CheckpointRecord
from .console import print_result

if TYPE_CHECKING:
    from ..weights import CheckpointReport

LAYOUTS = {
    "own": "this toolkit's own names",
    "torchvision": "torchvision's names of a ResNet",
    "vovnet": "detectron2's names of a VoVNet",
    "mmdetection3d": "mmdetection3d's names of an image backbone and neck",
}
FEW = 12  # names that are shown one by one


def print_checkpoint(report: "CheckpointReport", source: str) -> None:
    """Print how a checkpoint fits a model."""
    print_result(_table(report, source))
    for note in report.notes:
        print_result(f"note: {note}", markup=False, soft_wrap=True)
    if report.accepted:
        print_result(f"[green]accepted[/green]: {report.verdict}", soft_wrap=True)
        return
    print_result(f"[red]refused[/red]: {escape(report.verdict)}", soft_wrap=True)
    if report.missing:
        print_result("what is missing can be drawn at random: --allow-missing PATTERN", soft_wrap=True)


def summarise(record: CheckpointRecord) -> list[str]:
    """What a manifest says of the checkpoint that the weights came in, a line each."""
    lines = [f"{record.matched} tensors by {LAYOUTS[record.layout]}{_inside(record.wrappers)}"]
    if record.missing:
        patterns = ", ".join(dict.fromkeys(record.missing.values()))
        lines.append(f"{len(record.missing)} tensors missing, allowed by {patterns}: drawn from seed {record.seed}")
    if record.left_aside:
        lines.append(f"{len(record.left_aside)} tensors left aside: {_grouped(record.left_aside)}")
    return lines + [f"note: {note}" for note in record.notes]


def _table(report: "CheckpointReport", source: str) -> Table:
    title = f"{source}: {LAYOUTS[report.layout]}{_inside(report.wrappers)}"
    table = Table("", "", "tensors", title=escape(title), title_justify="left")
    table.columns[1].justify = "right"
    table.add_row("matched", str(len(report.matched)), _grouped(report.matched))
    table.add_row("missing, allowed", str(len(report.allowed_missing)), _grouped(report.allowed_missing))
    for kind, tensors in report.faults.items():
        table.add_row(kind, str(len(tensors)), escape(_listed(tensors)), style="red" if tensors else None)
    table.add_row("left aside", str(len(report.left_aside)), escape(_grouped(report.left_aside)))
    return table


def _inside(wrappers: Iterable[str]) -> str:
    path = ".".join(wrappers)
    return f", inside {path}" if path else ""


def _listed(tensors: list[str]) -> str:
    """Faults one by one where they are few, or else grouped, with the first few."""
    if len(tensors) <= FEW:
        return "\n".join(tensors)
    return "\n".join(
        [*tensors[:3], f"and {len(tensors) - 3} more (--json has all of them), in all:", _grouped(tensors)]
    )


def _grouped(names: Iterable[str]) -> str:
    """Names by their first two words, and how many there are of each."""
    names = list(names)
    if len(names) <= 2:
        return ", ".join(names)
    groups = Counter(".".join(name.split(" ")[0].split(".")[:2]) for name in names)
    return ", ".join(f"{group} ({count})" if count > 1 else group for group, count in groups.items())
