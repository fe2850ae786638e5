"""A note about streams that are faster than the data that a model was trained on."""

from itertools import pairwise

import numpy as np

from ..data.source import Source
from ..runtime.bundle.temporal_window import TemporalWindow
from .notify import Notify

SEARCHED_FRAMES = 50
FAST = 0.7  # of the nominal time between frames


def note_fast_stream(source: Source, window: TemporalWindow, notify: Notify) -> None:
    """Tell the user if the first frames of a source follow each other faster than the model's window expects.

    It is no warning: nothing is wrong with such a source.
    window: of the bundle that runs without a history step.
    """
    frames = [source.frame_without_images(index) for index in range(len(source))[:SEARCHED_FRAMES]]
    intervals_s = [now.timestamp_s - last.timestamp_s for last, now in pairwise(frames) if now.scene == last.scene]
    nominal_s = window.nominal_time_delta_s
    if window.num_frames == 1 or not intervals_s or np.median(intervals_s) >= FAST * nominal_s:
        return
    notify(
        f"note: the frames are {np.median(intervals_s):.2g} s apart, and those that the model was trained on "
        f"{nominal_s:g} s. --history-step {nominal_s:g} keeps the window at that step."
    )
