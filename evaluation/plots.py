"""Plots of an evaluation: precision and true positive errors over recall, per class. Needs the extra `viz`."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from ..runtime.errors import OutputError
from ..runtime.files import atomic_folder
from ..runtime.matplotlib_folders import temporary_matplotlib_folders
from .evaluation_report import ClassReport, EvaluationReport
from .lost_camera_plot import write_lost_camera_plot
from .precision_curve import RECALL
from .protocol import ABBREVIATIONS, ERROR_DISTANCE_M, MIN_PRECISION, MIN_RECALL, UNDEFINED_ERRORS, UNITS

with temporary_matplotlib_folders():
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

NUM_COLUMNS = 5
SIZE_IN = (20.0, 8.0)
DPI = 80


def write_plots(
    folder: Path, report: EvaluationReport, lost_cameras: Mapping[str, Sequence[float]] | None = None
) -> None:
    """Write `precision.png` and `errors.png` to a new folder, which appears only when all files are complete.

    lost_cameras: scores by name over the number of lost cameras, for `lost_cameras.png`; None or empty for no such
        file.
    Raises OutputError if the folder exists or cannot be written. No files remain then.
    """
    check_new_folder(folder)
    with atomic_folder(folder) as staging_dir:
        _write(staging_dir / "precision.png", report, _draw_precision)
        _write(staging_dir / "errors.png", report, _draw_errors)
        if lost_cameras:
            write_lost_camera_plot(staging_dir / "lost_cameras.png", lost_cameras)


def check_new_folder(folder: Path) -> None:
    """Raise OutputError if `folder` exists."""
    if folder.exists():
        raise OutputError(f"{folder}: expected a new folder for the plots; it exists already. Choose another folder.")


def _write(path: Path, report: EvaluationReport, draw: Callable[[Axes, ClassReport], None]) -> None:
    """Write a figure with one panel per class."""
    figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="tight")
    num_rows = -(-len(report.classes) // NUM_COLUMNS)
    panels = figure.subplots(num_rows, NUM_COLUMNS, sharex=True, squeeze=False)
    for axes, class_report in zip(panels.flat, report.classes, strict=False):
        draw(axes, class_report)
        axes.set_title(f"{class_report.name}: {class_report.num_truth} true, {class_report.num_detections} detected")
        axes.axvline(MIN_RECALL, color="grey", linestyle=":")
        axes.set(xlabel="recall", xlim=(0, 1))
        axes.legend(fontsize="small")
    FigureCanvasAgg(figure).print_png(str(path))


def _draw_precision(axes: Axes, class_report: ClassReport) -> None:
    """Draw one line per matching distance. Lines often coincide, so larger distances get wider lines below."""
    for distance_m, curve in class_report.curves.items():
        label = f"{distance_m:g} m: AP {curve.average_precision:.3f}"
        axes.plot(RECALL, curve.precision, label=label, linewidth=1 + distance_m / 2, zorder=3 - distance_m / 10)
    axes.axhline(MIN_PRECISION, color="grey", linestyle=":")
    axes.set(ylabel="precision", ylim=(0, 1))


def _draw_errors(axes: Axes, class_report: ClassReport) -> None:
    """Draw the defined errors up to the largest recall reached."""
    curve = class_report.curves[ERROR_DISTANCE_M]
    reached = slice(curve.max_recall_index + 1)
    for name, value in class_report.errors.items():
        if name not in UNDEFINED_ERRORS.get(class_report.name, ()):
            label = f"{ABBREVIATIONS[name]} {value:.3f} {UNITS.get(name, '')}"
            axes.plot(RECALL[reached], curve.errors[name][reached], label=label)
    axes.set(ylabel=f"error at {ERROR_DISTANCE_M:g} m")
    axes.set_ylim(bottom=0)
