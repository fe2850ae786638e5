"""A plot of mAP and NDS over the number of lost cameras. Needs the extra `viz`."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..runtime.matplotlib_folders import temporary_matplotlib_folders

with temporary_matplotlib_folders():
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

SIZE_IN = (7.0, 4.5)
DPI = 100
LABEL_OFFSET_PT = 7


def write_lost_camera_plot(path: Path, scores: Mapping[str, Sequence[float]]) -> None:
    """Write a PNG file with one line per score.

    scores: values by name, with 0, 1, 2, ... cameras lost in every frame.
    """
    figure = Figure(figsize=SIZE_IN, dpi=DPI, layout="tight")
    axes = figure.subplots()
    uppermost = max(scores, key=lambda name: sum(scores[name]), default="")
    for name, values in scores.items():
        [line] = axes.plot(range(len(values)), values, marker="o", label=name)
        above = name == uppermost  # the numbers of the other lines are below them, where they hide no line
        style: dict[str, Any] = {"color": line.get_color(), "ha": "center", "va": "bottom" if above else "top"}
        offset = (0, LABEL_OFFSET_PT if above else -LABEL_OFFSET_PT)
        for number, value in enumerate(values):
            axes.annotate(f"{value:.3f}", (number, value), offset, textcoords="offset points", **style)
    num_numbers = max(map(len, scores.values()), default=1)
    largest = max((value for values in scores.values() for value in values), default=0.0)
    top = max(0.1, 1.15 * largest)
    axes.set(xlabel="lost cameras per frame, chosen at random", ylabel="score", ylim=(-0.08 * top, top))
    axes.set_xticks(range(num_numbers))
    axes.margins(x=0.08)
    axes.grid(axis="y", alpha=0.4)
    axes.legend(loc="upper right")
    FigureCanvasAgg(figure).print_png(str(path))
