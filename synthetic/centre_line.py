"""The centre line of a street in the global frame.

A place in a street is given as (along, across). along: arc length on the centre line [m]. across: distance from the
centre line [m], positive to the left.
"""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STRIP_STEP_M = 3.0


class CentreLine:
    """A curve in the ground plane, stored as samples at equal distances."""

    def __init__(self, start_m: float, step_m: float, heading_rad: Array, origin_m: Array) -> None:
        """start_m: arc length of the first sample.
        step_m: distance between samples.
        heading_rad: (n,) direction of the curve at each sample, not wrapped.
        origin_m: (2,) position at the arc length 0.
        """
        self._start_m = start_m
        self._step_m = step_m
        direction = np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=1)
        chords = step_m * (direction[1:] + direction[:-1]) / 2
        positions = np.concatenate([np.zeros((1, 2)), np.cumsum(chords, axis=0)])
        curvature = np.gradient(heading_rad, step_m)
        self._samples = np.column_stack([positions, heading_rad, curvature])
        self._samples[:, :2] += origin_m - self.interpolate(np.zeros(1))[0, :2]

    @property
    def ends_m(self) -> tuple[float, float]:
        """The arc lengths of its two ends."""
        return self._start_m, self._start_m + self._step_m * (len(self._samples) - 1)

    def headings(self, along_m: Array) -> Array:
        """Directions (n,) [rad], not wrapped, at (n,) arc lengths."""
        return self.interpolate(along_m)[:, 2]

    def positions(self, along_m: Array, across_m: Array | float) -> Array:
        """Positions (n, 2) [m] in the global frame of (n,) places (along, across)."""
        x, y, heading, _ = self.interpolate(along_m).T
        return offset_left(x, y, heading, across_m)

    def strip(self, start_m: float, end_m: float, right_m: float, left_m: float) -> Array:
        """The outline (k, 2) [m] of the area between two arc lengths and two distances across."""
        num_steps = max(1, int(np.ceil((end_m - start_m) / STRIP_STEP_M)))
        along = np.linspace(start_m, end_m, num_steps + 1)
        across = np.repeat([right_m, left_m], num_steps + 1)
        return self.positions(np.concatenate([along, along[::-1]]), across)

    def quads(self, starts_m: Array, ends_m: Array, right_m: Array, left_m: Array) -> Array:
        """The outlines (n, 4, 2) [m] of n short areas; see `strip`."""
        along = np.stack([starts_m, ends_m, ends_m, starts_m], axis=1)
        across = np.stack([right_m, right_m, left_m, left_m], axis=1)
        return self.positions(along.ravel(), across.ravel()).reshape(-1, 4, 2)

    def interpolate(self, along_m: Array) -> Array:
        """Rows (n, 4) of x, y [m], heading [rad], curvature [1/m] at (n,) arc lengths, clamped to the ends."""
        last = len(self._samples) - 1
        sample = np.minimum(np.maximum((along_m - self._start_m) / self._step_m, 0), last)
        before = np.minimum(sample.astype(np.int64), last - 1)
        first = self._samples[before]
        return first + (sample - before)[:, None] * (self._samples[before + 1] - first)


def offset_left(x_m: Array, y_m: Array, heading_rad: Array, across_m: Array | float) -> Array:
    """Positions (n, 2) [m], each `across_m` to the left of (x, y), seen in the direction of its heading."""
    positions = np.empty((len(x_m), 2))
    positions[:, 0] = x_m - across_m * np.sin(heading_rad)
    positions[:, 1] = y_m + across_m * np.cos(heading_rad)
    return positions
