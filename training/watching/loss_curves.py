"""Loss curves of a training run as an image. Needs matplotlib, which the extra `viz` installs."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from cycler import cycler

from ...runtime.files import atomic_path
from ...runtime.matplotlib_folders import temporary_matplotlib_folders
from .step_report import NOT_LOSSES
from .training_log import Line
from .validation_scores import ValidationScores

with temporary_matplotlib_folders():
    from matplotlib import rcParams
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

SMOOTHING_STEPS = 50  # the losses of single steps vary too much to read a trend


def write_loss_curves(log: Sequence[Line], validations: Sequence[ValidationScores], path: Path) -> None:
    """Write a PNG with one curve per loss and per score.

    log: the steps of a training, from `TrainingLog.steps`; it may be empty.
    validations: the validations of the training; it may be empty.
    path: the PNG file.

    Raises OutputError if the file cannot be written.
    """
    figure = draw_loss_curves(log, validations)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)


def draw_loss_curves(log: Sequence[Line], validations: Sequence[ValidationScores] = ()) -> Figure:
    """Return the total loss, its parts and the scores as curves. Up to 30 parts differ in colour or line style."""
    figure = Figure(figsize=(16.5 if validations else 11, 6), layout="constrained")
    total_axes, part_axes, *score_axes = figure.subplots(1, 3 if validations else 2, sharex=True)
    part_axes.set_prop_cycle(cycler(linestyle=["-", "--", ":"]) * rcParams["axes.prop_cycle"])
    total_axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    steps = np.array([line["step"] for line in log])
    names = [name for name in log[0] if name not in NOT_LOSSES] if log else []
    for name in names:
        values = _moving_average(np.array([line[name] for line in log]))
        axes = total_axes if name == "total" else part_axes
        axes.plot(steps[len(steps) - len(values) :], values, label=name.replace("_", " "), linewidth=1.2)
    for axes, title in ((total_axes, "total loss"), (part_axes, "its parts")):
        axes.set(title=title, xlabel="step", yscale="log")
        axes.grid(alpha=0.3, which="both")
    if names:
        part_axes.legend(fontsize="small", ncols=2)
    for axes in score_axes:
        _draw_scores(axes, validations)
    return figure


def _draw_scores(axes: Axes, validations: Sequence[ValidationScores]) -> None:
    """Draw the scores between 0 and 1 over the step: all but mAVE, which has a unit."""
    for name in dict.fromkeys(name for scores in validations for name in scores.scores() if name != "mAVE"):
        known = [(scores.step, scores.scores()[name]) for scores in validations if name in scores.scores()]
        axes.plot(*zip(*known, strict=True), label=name.replace("_", " "), marker=".", linewidth=1.2)
    axes.set(title="validation", xlabel="step", ylim=(0, 1))
    axes.grid(alpha=0.3)
    axes.legend(fontsize="small")


def _moving_average(values: np.ndarray) -> np.ndarray:
    """The mean of every window of SMOOTHING_STEPS values, or of a quarter of the values if there are fewer."""
    width = max(1, min(SMOOTHING_STEPS, len(values) // 4))
    sums = np.cumsum(np.concatenate([[0.0], values]))
    return (sums[width:] - sums[:-width]) / width
