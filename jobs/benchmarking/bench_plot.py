"""The picture of a benchmark: one stacked bar of stages per target. Needs the extra `viz`."""

from pathlib import Path

from ...runtime.errors import OutputError
from ...runtime.extras import needs_extra
from ...runtime.files import atomic_path
from ...runtime.matplotlib_folders import temporary_matplotlib_folders
from .bench_report import BenchReport, TargetReport

with needs_extra("viz"), temporary_matplotlib_folders():
    from matplotlib.axes import Axes
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

# The stages in the order in which they run, and their colours (Okabe and Ito). An alternative has the stage "model".
COLOURS = {
    "preprocess": "#999999",
    "projector": "#f0e442",
    "backbone": "#0072b2",
    "lifter": "#56b4e9",
    "decoder": "#d55e00",
    "segmenter": "#009e73",
    "model": "#cc79a7",
    "postprocess": "#444444",
}
WIDTH_IN, HEAD_IN, BAR_IN = 10.0, 1.9, 0.55
DPI = 110
MAX_NAME = 40


def check_picture_path(path: Path) -> None:
    """Raise OutputError if `path` exists or does not end with .png."""
    if path.suffix.lower() != ".png":
        raise OutputError(f"{path}: expected a name that ends with .png. Choose another --plot.")
    if path.exists() or path.is_symlink():
        raise OutputError(f"{path}: expected a new file; it exists already. Choose another --plot.")
    if not path.parent.is_dir():
        raise OutputError(f"{path}: expected a file in an existing folder; got no folder {path.parent}.")


def write_picture(path: Path, report: BenchReport) -> None:
    """Write the picture as PNG. Raises OutputError."""
    targets = {"bundle": report.figures, **report.alternatives}
    figure = Figure(figsize=(WIDTH_IN, HEAD_IN + BAR_IN * len(targets)), dpi=DPI, layout="constrained")
    axes = figure.subplots()
    _draw_bars(axes, targets)
    figure.legend(ncols=len(COLOURS), fontsize="small", loc="outside lower center", frameon=False)
    _label_bars(axes, targets, {"bundle": "", **{name: f"  ×{r.median:.2f}" for name, r in report.ratios.items()}})
    machine, bundle = report.machine, report.bundle
    axes.set_title(
        f"{bundle.preset}, {bundle.precision}: median time per frame\n"
        f"{machine.cpu}, {machine.threads} threads, {' '.join(machine.instruction_sets)}",
        fontsize=10,
    )
    with atomic_path(path) as temporary:
        FigureCanvasAgg(figure).print_png(str(temporary))


def _draw_bars(axes: Axes, targets: dict[str, TargetReport]) -> None:
    """One horizontal bar per target, from the top. The stages are medians, so their sum is near the median frame."""
    stages = [stage for stage in COLOURS if any(stage in target.stages_ms for target in targets.values())]
    left = [0.0] * len(targets)
    for stage in stages:
        widths = [target.stages_ms[stage].p50 if stage in target.stages_ms else 0.0 for target in targets.values()]
        axes.barh(range(len(targets)), widths, left=left, height=0.7, color=COLOURS[stage], label=stage)
        left = [start + width for start, width in zip(left, widths, strict=True)]
    axes.invert_yaxis()
    axes.set_xlabel("ms per frame")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def _label_bars(axes: Axes, targets: dict[str, TargetReport], ratios: dict[str, str]) -> None:
    """Name each bar; write the median frame and the ratio to the bundle beside it."""
    names = [name if len(name) <= MAX_NAME else f"…{name[1 - MAX_NAME :]}" for name in targets]
    axes.set_yticks(range(len(targets)), names, parse_math=False)
    ends = [sum(stage.p50 for stage in target.stages_ms.values()) for target in targets.values()]
    for row, (name, target) in enumerate(targets.items()):
        median_ms = target.frame_ms.p50
        text = f" {median_ms:.{0 if median_ms >= 100 else 1}f} ms{ratios[name]}"
        axes.text(ends[row], row, text, va="center", fontsize="small", parse_math=False)
    axes.set_xlim(0, 1.22 * max(ends))
