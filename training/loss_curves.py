"""The losses of a training as a picture. Needs matplotlib, of the extra `viz`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from ..runtime.files import atomic_path

NOT_A_LOSS = ("step", "gradient_norm")
WINDOW = 50  # steps that a line is the mean of; single frames differ much


def write_loss_curves(log: Sequence[dict[str, float]], path: Path) -> None:
    """Write a PNG with a curve a loss, over the steps of `log` (`TrainingFolder.log`).

    Raises OutputError where the file cannot be written.
    """
    figure = Figure(figsize=(11, 6), layout="constrained")
    whole, parts = figure.subplots(1, 2, sharex=True)
    steps = np.array([line["step"] for line in log])
    names = [name for name in log[0] if name not in NOT_A_LOSS] if log else []
    for name in names:
        values = _smooth(np.array([line[name] for line in log]))
        axes = whole if name == "total" else parts
        axes.plot(steps[len(steps) - len(values) :], values, label=name.replace("_", " "), linewidth=1.2)
    for axes, title in ((whole, "total loss"), (parts, "its parts")):
        axes.set(title=title, xlabel="step", yscale="log")
        axes.grid(alpha=0.3, which="both")
    if names:
        parts.legend(fontsize="small", ncols=2)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110)


def _smooth(values: np.ndarray) -> np.ndarray:
    """Means over `WINDOW` values, or over all where there are fewer; one value for each full window."""
    width = max(1, min(WINDOW, len(values) // 4))
    sums = np.cumsum(np.concatenate([[0.0], values]))
    return (sums[width:] - sums[:-width]) / width
