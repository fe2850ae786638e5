"""A warning about streams that are faster than the data that a model was trained on."""

from itertools import pairwise

import numpy as np

from ..data.source import Source
from ..rig import Finding, Verdict
from ..runtime.bundle.manifest import TemporalWindow
from .input_warnings import DRIVE, InputWarnings

SEARCHED_FRAMES = 50
FAST = 0.7  # of the nominal time between frames


def warn_of_fast_stream(source: Source, window: TemporalWindow, warnings: InputWarnings, name: str = "") -> None:
    """Warn if the first frames of a source follow each other faster than the model's window expects.

    window: of the bundle that runs without a history step.
    name: of the source, if the job has several.
    """
    frames = [source.frame_without_images(index) for index in range(len(source))[:SEARCHED_FRAMES]]
    intervals_s = [now.timestamp_s - last.timestamp_s for last, now in pairwise(frames) if now.scene == last.scene]
    nominal_s = window.nominal_time_delta_s
    if window.num_frames == 1 or not intervals_s or np.median(intervals_s) >= FAST * nominal_s:
        return
    finding = Finding(
        "frame rate",
        Verdict.SUSPECT,
        f"about {nominal_s:g} s between frames, as in the training data",
        f"a median of {np.median(intervals_s):.2g} s",
        "The window of past frames is shorter than those that the model was trained on.",
        f"Add --history-step {nominal_s:g}.",
    )
    warnings.add([(DRIVE, finding)], name)
