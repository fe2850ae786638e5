"""The report of an evaluation as a table."""

from rich import box
from rich.markup import escape
from rich.table import Table

from ..evaluation import EvaluationReport
from ..evaluation.protocol import ABBREVIATIONS, MATCHING_DISTANCES_M, ERRORS, UNITS
from .console import print_result


def print_scores(report: EvaluationReport) -> None:
    """Print every number of a report, in two tables that fit into 80 columns, and its means."""
    print_result(_precision_table(report))
    print_result(_error_table(report))
    means = {f"m{ABBREVIATIONS[name]}": value for name, value in report.mean_errors.items()}
    scores = {"mAP": report.mean_average_precision, **means, "NDS": report.nds}
    print_result("  ".join(f"{name} {_number(value)}" for name, value in scores.items()), soft_wrap=True)
    for name, iou in report.map_iou.items():
        print_result(f"IoU of {escape(name)}: {_number(iou)}", soft_wrap=True)
    for note in _notes(report):
        print_result(note, markup=False, soft_wrap=True)


def _precision_table(report: EvaluationReport) -> Table:
    table = _table("true", "found", *(f"AP@{distance_m:g}" for distance_m in MATCHING_DISTANCES_M), "AP")
    for one in report.classes:
        numbers = (*one.average_precisions.values(), one.mean_average_precision)
        table.add_row(one.name, str(one.num_truth), str(one.num_detections), *map(_number, numbers))
    return table


def _error_table(report: EvaluationReport) -> Table:
    table = _table(*(f"{ABBREVIATIONS[name]} {UNITS.get(name, '')}".rstrip() for name in ERRORS))
    for one in report.classes:
        table.add_row(one.name, *map(_number, one.errors.values()))
    return table


def _table(*columns: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("class", no_wrap=True)
    for column in columns:
        table.add_column(escape(column), justify="right", no_wrap=True)
    return table


def _notes(report: EvaluationReport) -> list[str]:
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
