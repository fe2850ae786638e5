"""The report of an evaluation as a table."""

from rich import box
from rich.markup import escape
from rich.table import Table

from ..evaluation import ClassReport, Report
from ..evaluation.protocol import ABBREVIATIONS, DISTANCES_M
from .console import results


def print_scores(report: Report) -> None:
    """Print every number of a report."""
    results.print(_table(report))
    means = {f"m{ABBREVIATIONS[name]}": value for name, value in report.mean_errors.items()}
    scores = {"mAP": report.mean_average_precision, **means, "NDS": report.nds}
    results.print("  ".join(f"{name} {_number(value)}" for name, value in scores.items()), soft_wrap=True)
    for name, iou in report.map_iou.items():
        results.print(f"IoU of {escape(name)}: {_number(iou)}", soft_wrap=True)
    for note in _notes(report):
        results.print(note, markup=False, soft_wrap=True)


def _table(report: Report) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("class", no_wrap=True)
    distances = (f"AP@{distance_m:g}" for distance_m in DISTANCES_M)
    for column in ("true", "found", *distances, "AP", *ABBREVIATIONS.values()):
        table.add_column(column, justify="right", no_wrap=True)
    for one in report.classes:
        table.add_row(one.name, *_cells(one))
    return table


def _cells(one: ClassReport) -> list[str]:
    numbers = (*one.average_precisions.values(), one.mean_average_precision, *one.errors.values())
    return [str(one.num_truth), str(one.num_detections), *map(_number, numbers)]


def _notes(report: Report) -> list[str]:
    frames = f"{report.num_samples} frame{'' if report.num_samples == 1 else 's'}"
    notes = [
        f"{frames}; boxes within the class's range. A class without a truth has AP 0 and errors of 1, as in nuScenes.",
        "AAE: the true attributes are derived from the true speeds, by the rule that gives a detection its own.",
    ]
    if report.ignored:
        ignored = ", ".join(f"{name} ({number})" for name, number in report.ignored.items())
        notes.append(f"true boxes of classes that nuScenes' benchmark does not have, left out: {ignored}")
    return notes


def _number(value: float) -> str:
    return "-" if value != value else f"{value:.3f}"
