"""The road of a drawn drive: a curved street in the global frame, its cross-section and its cross streets.

Along a street a place is (along, across): metres of arc length on the centre line, metres to its left. Traffic
keeps to the right.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

LANE_WIDTH_M = 3.5
PARKING_WIDTH_M = 3.2
SIDEWALK_WIDTH_M = 4.6
KERB_WIDTH_M = 0.22
STATION_STEP_M = 0.5
PATCH_STEP_M = 3.0
CROSS_STREET_REACH_M = 130.0
CROSS_STREET_SPACING_M = 160.0
MARGIN_M = 220.0  # of road before the start and after the end of a drive
BOUNDARY_WIDTH_M = 0.15


class Curve:
    """A street's centre line, sampled every `step_m` from `start_m`; the origin lies at along = 0."""

    def __init__(self, start_m: float, step_m: float, heading_rad: Array, origin_m: Array) -> None:
        self._start_m = start_m
        self._step_m = step_m
        direction = np.stack([np.cos(heading_rad), np.sin(heading_rad)], axis=1)
        chords = step_m * (direction[1:] + direction[:-1]) / 2
        positions = np.concatenate([np.zeros((1, 2)), np.cumsum(chords, axis=0)])
        curvature = np.gradient(heading_rad, step_m)
        self._stations = np.column_stack([positions, heading_rad, curvature])
        self._stations[:, :2] += origin_m - self.at(np.zeros(1))[0, :2]

    @property
    def ends_m(self) -> tuple[float, float]:
        """The arc lengths of its two ends."""
        return self._start_m, self._start_m + self._step_m * (len(self._stations) - 1)

    def heading(self, along_m: Array) -> Array:
        """Direction of the centre line [rad], not wrapped, at (n,) arc lengths."""
        return self.at(along_m)[:, 2]

    def place(self, along_m: Array, across_m: Array | float) -> Array:
        """Positions (n, 2) [m] in the global frame, of (n,) places along and across."""
        x, y, heading, _ = self.at(along_m).T
        return beside(x, y, heading, across_m)

    def strip(self, start_m: float, end_m: float, right_m: float, left_m: float) -> Array:
        """The outline (k, 2) of the street between two arc lengths and two distances across."""
        num_steps = max(1, int(np.ceil((end_m - start_m) / PATCH_STEP_M)))
        along = np.linspace(start_m, end_m, num_steps + 1)
        across = np.repeat([right_m, left_m], num_steps + 1)
        return self.place(np.concatenate([along, along[::-1]]), across)

    def quads(self, starts_m: Array, ends_m: Array, right_m: Array, left_m: Array) -> Array:
        """The outlines (n, 4, 2) of n short pieces; see `strip`."""
        along = np.stack([starts_m, ends_m, ends_m, starts_m], axis=1)
        across = np.stack([right_m, right_m, left_m, left_m], axis=1)
        return self.place(along.ravel(), across.ravel()).reshape(-1, 4, 2)

    def at(self, along_m: Array) -> Array:
        """x, y, heading and curvature (n, 4) at (n,) arc lengths; the ends' beyond the ends."""
        last = len(self._stations) - 1
        station = np.minimum(np.maximum((along_m - self._start_m) / self._step_m, 0), last)
        before = np.minimum(station.astype(np.int64), last - 1)
        first = self._stations[before]
        return first + (station - before)[:, None] * (self._stations[before + 1] - first)


@dataclass(frozen=True)
class CrossSection:
    """What lies beside the centre line, the same on both sides."""

    num_lanes: int
    parking_m: float

    @property
    def lanes_m(self) -> float:
        """From the centre line to the outer edge of the outer lane."""
        return self.num_lanes * LANE_WIDTH_M

    @property
    def kerb_m(self) -> float:
        """From the centre line to the road's edge."""
        return self.lanes_m + self.parking_m

    @property
    def outside_m(self) -> float:
        """From the centre line to the sidewalk's outer edge."""
        return self.kerb_m + SIDEWALK_WIDTH_M


class CrossStreet(NamedTuple):
    """A straight street that crosses the main one at `along_m` of it; they are numbered along it."""

    number: int
    along_m: float
    curve: Curve
    section: CrossSection


class Patch(NamedTuple):
    """A piece of ground of one kind: its outline (k, 2) [m] in the global frame."""

    kind: str
    outline: Array


class Road:
    """The main street, long enough for a drive of `length_m` that starts at along = 0."""

    def __init__(self, seed: int, length_m: float) -> None:
        rng = np.random.default_rng([seed, 1])
        self._seed = seed
        self.curve = _gentle_curve(rng, length_m)
        self.section = CrossSection(num_lanes=int(rng.integers(1, 3)), parking_m=PARKING_WIDTH_M)
        self._first_crossing_m = rng.uniform(10.0, 10.0 + CROSS_STREET_SPACING_M)
        self._cross_street = lru_cache(maxsize=64)(self._build_cross_street)

    def cross_streets(self, start_m: float, end_m: float) -> list[CrossStreet]:
        """The streets that cross between two arc lengths."""
        nearest = np.floor((np.array([start_m, end_m]) - self._first_crossing_m) / CROSS_STREET_SPACING_M)
        candidates = (self._cross_street(k) for k in range(int(nearest[0]) - 1, int(nearest[1]) + 2))
        return [street for street in candidates if start_m <= street.along_m <= end_m]

    def _build_cross_street(self, number: int) -> CrossStreet:
        rng = np.random.default_rng([self._seed, 2, number + 2**31])
        along = self._first_crossing_m + CROSS_STREET_SPACING_M * number + rng.uniform(-20.0, 20.0)
        heading = self.curve.heading(np.array([along]))[0] + np.pi / 2 + rng.uniform(-0.12, 0.12)
        curve = Curve(
            -CROSS_STREET_REACH_M,
            CROSS_STREET_REACH_M,
            np.full(3, heading),
            self.curve.place(np.array([along]), 0.0)[0],
        )
        return CrossStreet(number, along, curve, CrossSection(num_lanes=1, parking_m=1.2))

    def patches(self, start_m: float, end_m: float) -> Iterator[Patch]:
        """The ground between two arc lengths, in painter's order: later patches lie over earlier ones."""
        crossings = self.cross_streets(start_m, end_m)
        streets = [(self.curve, self.section, start_m, end_m)]
        streets += [(c.curve, c.section, *c.curve.ends_m) for c in crossings]
        for kind in ("sidewalk", "kerb", "asphalt"):
            for curve, section, start, end in streets:
                half = _half_width(section, kind)
                yield Patch(kind, curve.strip(start, end, -half, half))
        for crossing in crossings:
            yield from self._zebras(crossing)
        for start, end in self._between(crossings, start_m, end_m):
            yield from self._markings(start, end)
        for crossing in crossings:
            for start, end in self._arms(crossing):
                yield Patch("yellow", crossing.curve.strip(start, end, -0.08, 0.08))

    def boundaries(self, start_m: float, end_m: float) -> Iterator[Array]:
        """Outlines (k, 2) of all lane lines and road edges, `BOUNDARY_WIDTH_M` wide, open at crossings."""
        half = BOUNDARY_WIDTH_M / 2
        crossings = self.cross_streets(start_m, end_m)
        for start, end in self._between(crossings, start_m, end_m):
            for across in _line_offsets(self.section):
                yield self.curve.strip(start, end, across - half, across + half)
        for crossing in crossings:
            for start, end in self._arms(crossing):
                for across in (-crossing.section.kerb_m, 0.0, crossing.section.kerb_m):
                    yield crossing.curve.strip(start, end, across - half, across + half)

    def _between(self, crossings: list[CrossStreet], start_m: float, end_m: float) -> Iterator[tuple[float, float]]:
        """The stretches of the main street that no cross street interrupts."""
        for crossing in crossings:
            yield start_m, crossing.along_m - crossing.section.kerb_m - 0.8
            start_m = crossing.along_m + crossing.section.kerb_m + 0.8
        yield start_m, end_m

    def _arms(self, crossing: CrossStreet) -> Iterator[tuple[float, float]]:
        """The two stretches of a cross street outside the main one."""
        start, end = crossing.curve.ends_m
        mouth = self.section.kerb_m + 0.8
        yield start, -mouth
        yield mouth, end

    def _markings(self, start_m: float, end_m: float) -> Iterator[Patch]:
        """Lane lines: a double yellow centre line, dashes between lanes, the parking strips' edges."""
        curve, section = self.curve, self.section
        for across in (-0.17, 0.17):
            yield Patch("yellow", curve.strip(start_m, end_m, across - 0.06, across + 0.06))
        for across in (-section.lanes_m, section.lanes_m):
            yield Patch("white", curve.strip(start_m, end_m, across - 0.07, across + 0.07))
        starts = np.arange(np.ceil(start_m / 9.0) * 9.0, end_m - 3.0, 9.0)
        for lane in range(1, section.num_lanes):
            for across in (-lane * LANE_WIDTH_M, lane * LANE_WIDTH_M):
                middle = np.full(len(starts), across)
                for outline in curve.quads(starts, starts + 3.0, middle - 0.08, middle + 0.08):
                    yield Patch("white", outline)

    def _zebras(self, crossing: CrossStreet) -> Iterator[Patch]:
        """The bars of a cross street's two crosswalks, in line with the main street's sidewalks."""
        reach = crossing.section.kerb_m
        for side in (-1, 1):
            near, far = sorted((side * (self.section.kerb_m + 0.8), side * (self.section.outside_m - 0.8)))
            across = np.arange(-reach + 0.4, reach - 0.5, 1.1)
            nears, fars = np.full(len(across), near), np.full(len(across), far)
            for outline in crossing.curve.quads(nears, fars, across, across + 0.55):
                yield Patch("white", outline)


def beside(x_m: Array, y_m: Array, heading_rad: Array, across_m: Array | float) -> Array:
    """Positions (n, 2), `across_m` to the left of places (n,) with a heading."""
    positions = np.empty((len(x_m), 2))
    positions[:, 0] = x_m - across_m * np.sin(heading_rad)
    positions[:, 1] = y_m + across_m * np.cos(heading_rad)
    return positions


def _gentle_curve(rng: np.random.Generator, length_m: float) -> Curve:
    """A street that winds by two sine waves of heading, so that it never turns back on itself."""
    start = -MARGIN_M
    stations = np.arange(start, length_m + MARGIN_M, STATION_STEP_M)
    amplitudes_rad = rng.uniform([0.05, 0.0], [0.25, 0.1])
    wavelengths_m = rng.uniform([200.0, 130.0], [350.0, 200.0])
    phases_rad = rng.uniform(0.0, 2 * np.pi, 2)
    waves = amplitudes_rad * np.sin(2 * np.pi * stations[:, None] / wavelengths_m + phases_rad)
    heading = rng.uniform(-np.pi, np.pi) + waves.sum(axis=1)
    return Curve(start, STATION_STEP_M, heading, rng.uniform(300.0, 1800.0, 2))


def _half_width(section: CrossSection, kind: str) -> float:
    widths = {"sidewalk": section.outside_m, "kerb": section.kerb_m + KERB_WIDTH_M, "asphalt": section.kerb_m}
    return widths[kind]


def _line_offsets(section: CrossSection) -> list[float]:
    """Distances across of the lane lines and of the road's two edges."""
    one_side = [lane * LANE_WIDTH_M for lane in range(1, section.num_lanes + 1)] + [section.kerb_m]
    return [-across for across in one_side] + [0.0, *one_side]
