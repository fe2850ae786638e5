"""Loss curves of a training run as an image. Needs matplotlib, which the extra `viz` installs."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..runtime.files import atomic_path
from ..runtime.matplotlib_folders import temporary_matplotlib_folders

with temporary_matplotlib_folders():
    from matplotlib.figure import Figure

NOT_LOSSES = ("step", "gradient_norm")
SMOOTHING_STEPS = 50  # the losses of single steps vary too much to read a trend


def write_loss_curves(log: Sequence[dict[str, float]], path: Path) -> None:
    """Write a PNG with one curve per loss.

    log: the result of `TrainingFolder.read_log`; it may be empty.
    path: the PNG file.

    Raises OutputError if the file cannot be written.
    """
    figure = Figure(figsize=(11, 6), layout="constrained")
    total_axes, part_axes = figure.subplots(1, 2, sharex=True)
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
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)


def _moving_average(values: np.ndarray) -> np.ndarray:
    """The mean of every window of SMOOTHING_STEPS values, or of a quarter of the values if there are fewer."""
    width = max(1, min(SMOOTHING_STEPS, len(values) // 4))
    sums = np.cumsum(np.concatenate([[0.0], values]))
    return (sums[width:] - sums[:-width]) / width
