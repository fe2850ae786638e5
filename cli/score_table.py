"""The report of an evaluation as tables."""

from typing import TYPE_CHECKING

from rich import box
from rich.markup import escape
from rich.table import Table

from ..evaluation.protocol import ABBREVIATIONS, ERRORS, MATCHING_DISTANCES_M, UNITS
from .console import print_result

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..evaluation import EvaluationReport
    from ..jobs.lost_camera_scores import LostCameraScore
    from ..jobs.scoring import BundleScores
    from ..jobs.submission_scoring import SubmissionScores


def print_scores(scores: "BundleScores | SubmissionScores") -> None:
    """Print what was evaluated, every number of its report in two tables of at most 80 columns, and the means."""
    print_result(scores.subject, markup=False, soft_wrap=True)
    report = scores.report
    if report.has_boxes:
        _print_box_scores(report)
    for name, iou in report.map_iou.items():
        print_result(f"IoU of {escape(name)}: {_number(iou)}", soft_wrap=True)
    if scores.lost_cameras:
        print_result(_lost_camera_table(scores.lost_cameras))
    for note in (*_judged(report), *_notes(report)):
        print_result(note, markup=False, soft_wrap=True)


def _print_box_scores(report: "EvaluationReport") -> None:
    print_result(_precision_table(report))
    print_result(_error_table(report))
    means = {f"m{ABBREVIATIONS[name]}": value for name, value in report.mean_errors.items()}
    means = {"mAP": report.mean_average_precision, **means, "NDS": report.nds}
    print_result("  ".join(f"{name} {_number(value)}" for name, value in means.items()), soft_wrap=True)


def _precision_table(report: "EvaluationReport") -> Table:
    table = _table("true", "detected", *(f"AP@{distance_m:g}" for distance_m in MATCHING_DISTANCES_M), "AP")
    for scores in report.classes:
        numbers = (*scores.average_precisions.values(), scores.mean_average_precision)
        table.add_row(scores.name, str(scores.num_truth), str(scores.num_detections), *map(_number, numbers))
    return table


def _error_table(report: "EvaluationReport") -> Table:
    table = _table(*(f"{ABBREVIATIONS[name]} {UNITS.get(name, '')}".rstrip() for name in ERRORS))
    for scores in report.classes:
        table.add_row(scores.name, *map(_number, scores.errors.values()))
    return table


def _lost_camera_table(scores: "Sequence[LostCameraScore]") -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    for column in ("lost cameras", "mAP", "NDS"):
        table.add_column(column, justify="right", no_wrap=True)
    for score in scores:
        table.add_row(str(score.num_lost), _number(score.mean_ap), _number(score.nds))
    return table


def _table(*columns: str) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, collapse_padding=True)
    table.add_column("class", no_wrap=True)
    for column in columns:
        table.add_column(escape(column), justify="right", no_wrap=True)
    return table


def _judged(report: "EvaluationReport") -> list[str]:
    """What was evaluated in how many frames, and what was not."""
    numbers = {"boxes": report.num_samples} if report.has_boxes else {}
    numbers |= report.num_map_samples
    frames = (f"{name} in {number} frame{'' if number == 1 else 's'}" for name, number in numbers.items())
    lines = [f"judged: {', '.join(frames)}"]
    if not report.has_boxes:
        lines.append("not judged: boxes, because no frame has true boxes")
    if not report.num_map_samples:
        lines.append("not judged: maps, because there are no true masks, or no predicted ones")
    return lines


def _notes(report: "EvaluationReport") -> list[str]:
    if not report.has_boxes:
        return []
    notes = [
        "Only boxes within the range of their class. A class without true boxes has AP 0 and errors of 1, as in "
        "nuScenes.",
    ]
    if report.derives_attributes:
        notes.append("AAE: true attributes are derived from true speeds, by the same rule as those of detections.")
    notes += [f"ground truth: {line}" for line in report.ground_truth.lines()]
    return notes


def _number(value: float) -> str:
    return "-" if value != value else f"{value:.3f}"
