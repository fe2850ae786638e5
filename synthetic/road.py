"""The streets of a synthetic drive: a winding main street and its cross streets, with areas and lines on the ground.

Traffic keeps to the right. Places are given as (along, across); see `centre_line`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .centre_line import CentreLine

Array = NDArray[np.float64]

LANE_WIDTH_M = 3.5
PARKING_WIDTH_M = 3.2
SIDEWALK_WIDTH_M = 4.6
KERB_WIDTH_M = 0.22
SAMPLE_STEP_M = 0.5
CROSS_STREET_REACH_M = 130.0
CROSS_STREET_SPACING_M = 160.0
MARGIN_M = 220.0  # length of the road before the start and after the end of a drive
CROSSING_GAP_M = 0.8  # between the end of a marking and the edge of the street that crosses
BOUNDARY_WIDTH_M = 0.15
SEED_OFFSET = 2**31  # added to street and block numbers, which may be negative; numpy accepts no negative seeds


@dataclass(frozen=True)
class CrossSection:
    """The widths of a street, from its centre line outwards. Both sides are the same.

    num_lanes: per side.
    parking_m: width of the parking strip.
    """

    num_lanes: int
    parking_m: float

    @property
    def lanes_m(self) -> float:
        """Distance from the centre line to the outer edge of the outer lane."""
        return self.num_lanes * LANE_WIDTH_M

    @property
    def kerb_m(self) -> float:
        """Distance from the centre line to the edge of the road."""
        return self.lanes_m + self.parking_m

    @property
    def outside_m(self) -> float:
        """Distance from the centre line to the outer edge of the sidewalk."""
        return self.kerb_m + SIDEWALK_WIDTH_M


class CrossStreet(NamedTuple):
    """A straight street that crosses the main street.

    number: index of the crossing along the main street; may be negative.
    along_m: arc length of the crossing on the main street.
    centre_line, section: of the cross street.
    """

    number: int
    along_m: float
    centre_line: CentreLine
    section: CrossSection


class GroundPatch(NamedTuple):
    """An area of the ground.

    kind: "sidewalk", "kerb", "asphalt", or the colour of a marking, "white" or "yellow".
    outline: (k, 2) [m] in the global frame.
    """

    kind: str
    outline: Array


class Road:
    """The streets of a drive that starts at along = 0 of the main street and is `length_m` long."""

    def __init__(self, seed: int, length_m: float) -> None:
        rng = np.random.default_rng([seed, 1])
        self._seed = seed
        self.centre_line = _winding_centre_line(rng, length_m)
        self.section = CrossSection(num_lanes=int(rng.integers(1, 3)), parking_m=PARKING_WIDTH_M)
        self._first_crossing_m = rng.uniform(10.0, 10.0 + CROSS_STREET_SPACING_M)
        self._cross_street = lru_cache(maxsize=64)(self._build_cross_street)

    def cross_streets(self, start_m: float, end_m: float) -> list[CrossStreet]:
        """The streets that cross the main street between two of its arc lengths."""
        nearest = np.floor((np.array([start_m, end_m]) - self._first_crossing_m) / CROSS_STREET_SPACING_M)
        candidates = (self._cross_street(k) for k in range(int(nearest[0]) - 1, int(nearest[1]) + 2))
        return [street for street in candidates if start_m <= street.along_m <= end_m]

    def ground_patches(self, start_m: float, end_m: float) -> Iterator[GroundPatch]:
        """The ground between two arc lengths, in rendering order: a later patch covers earlier ones."""
        crossings = self.cross_streets(start_m, end_m)
        streets = [(self.centre_line, self.section, start_m, end_m)]
        streets += [(c.centre_line, c.section, *c.centre_line.ends_m) for c in crossings]
        for kind in ("sidewalk", "kerb", "asphalt"):
            for centre_line, section, start, end in streets:
                half = _half_width(section, kind)
                yield GroundPatch(kind, centre_line.strip(start, end, -half, half))
        for crossing in crossings:
            yield from self._crosswalks(crossing)
        for start, end in self.stretches(crossings, start_m, end_m):
            yield from self._markings(start, end)
        for crossing in crossings:
            for start, end in self.cross_street_stretches(crossing):
                yield GroundPatch("yellow", crossing.centre_line.strip(start, end, -0.08, 0.08))

    def lane_boundaries(self, start_m: float, end_m: float) -> Iterator[Array]:
        """Outlines (k, 2) [m] of all lane lines and road edges, `BOUNDARY_WIDTH_M` wide, interrupted at crossings."""
        half = BOUNDARY_WIDTH_M / 2
        crossings = self.cross_streets(start_m, end_m)
        for start, end in self.stretches(crossings, start_m, end_m):
            for across in _line_offsets(self.section):
                yield self.centre_line.strip(start, end, across - half, across + half)
        for crossing in crossings:
            for start, end in self.cross_street_stretches(crossing):
                for across in (-crossing.section.kerb_m, 0.0, crossing.section.kerb_m):
                    yield crossing.centre_line.strip(start, end, across - half, across + half)

    def stretches(self, crossings: list[CrossStreet], start_m: float, end_m: float) -> Iterator[tuple[float, float]]:
        """The stretches of the main street between crossings."""
        for crossing in crossings:
            yield start_m, crossing.along_m - crossing.section.kerb_m - CROSSING_GAP_M
            start_m = crossing.along_m + crossing.section.kerb_m + CROSSING_GAP_M
        yield start_m, end_m

    def cross_street_stretches(self, crossing: CrossStreet) -> Iterator[tuple[float, float]]:
        """The two stretches of a cross street, on either side of the main street."""
        start, end = crossing.centre_line.ends_m
        mouth = self.section.kerb_m + CROSSING_GAP_M
        yield start, -mouth
        yield mouth, end

    def crosswalks(self, crossing: CrossStreet) -> list[tuple[float, float]]:
        """The two ends [m], along a cross street, of its two crosswalks: in line with the main street's sidewalks."""
        near, far = self.section.kerb_m + 0.8, self.section.outside_m - 0.8
        return [(-far, -near), (near, far)]

    def _build_cross_street(self, number: int) -> CrossStreet:
        rng = np.random.default_rng([self._seed, 2, number + SEED_OFFSET])
        along = self._first_crossing_m + CROSS_STREET_SPACING_M * number + rng.uniform(-20.0, 20.0)
        heading = self.centre_line.headings(np.array([along]))[0] + np.pi / 2 + rng.uniform(-0.12, 0.12)
        centre_line = CentreLine(
            -CROSS_STREET_REACH_M,
            CROSS_STREET_REACH_M,
            np.full(3, heading),
            self.centre_line.positions(np.array([along]), 0.0)[0],
        )
        return CrossStreet(number, along, centre_line, CrossSection(num_lanes=1, parking_m=1.2))

    def _markings(self, start_m: float, end_m: float) -> Iterator[GroundPatch]:
        """Lane lines: a double yellow centre line, dashes between lanes, and the edges of the parking strips."""
        centre_line, section = self.centre_line, self.section
        for across in (-0.17, 0.17):
            yield GroundPatch("yellow", centre_line.strip(start_m, end_m, across - 0.06, across + 0.06))
        for across in (-section.lanes_m, section.lanes_m):
            yield GroundPatch("white", centre_line.strip(start_m, end_m, across - 0.07, across + 0.07))
        starts = np.arange(np.ceil(start_m / 9.0) * 9.0, end_m - 3.0, 9.0)
        for lane in range(1, section.num_lanes):
            for across in (-lane * LANE_WIDTH_M, lane * LANE_WIDTH_M):
                middle = np.full(len(starts), across)
                for outline in centre_line.quads(starts, starts + 3.0, middle - 0.08, middle + 0.08):
                    yield GroundPatch("white", outline)

    def _crosswalks(self, crossing: CrossStreet) -> Iterator[GroundPatch]:
        """The bars of the two crosswalks over a cross street, in line with the sidewalks of the main street."""
        reach = crossing.section.kerb_m
        for near, far in self.crosswalks(crossing):
            across = np.arange(-reach + 0.4, reach - 0.5, 1.1)
            nears, fars = np.full(len(across), near), np.full(len(across), far)
            for outline in crossing.centre_line.quads(nears, fars, across, across + 0.55):
                yield GroundPatch("white", outline)


def _winding_centre_line(rng: np.random.Generator, length_m: float) -> CentreLine:
    """A centre line with a heading of two sine waves, small enough that the street never turns back."""
    start = -MARGIN_M
    along = np.arange(start, length_m + MARGIN_M, SAMPLE_STEP_M)
    amplitudes_rad = rng.uniform([0.05, 0.0], [0.25, 0.1])
    wavelengths_m = rng.uniform([200.0, 130.0], [350.0, 200.0])
    phases_rad = rng.uniform(0.0, 2 * np.pi, 2)
    waves = amplitudes_rad * np.sin(2 * np.pi * along[:, None] / wavelengths_m + phases_rad)
    heading = rng.uniform(-np.pi, np.pi) + waves.sum(axis=1)
    return CentreLine(start, SAMPLE_STEP_M, heading, rng.uniform(300.0, 1800.0, 2))


def _half_width(section: CrossSection, kind: str) -> float:
    """Half the width [m] of an area that is symmetric about the centre line."""
    widths = {"sidewalk": section.outside_m, "kerb": section.kerb_m + KERB_WIDTH_M, "asphalt": section.kerb_m}
    return widths[kind]


def _line_offsets(section: CrossSection) -> list[float]:
    """Distances across [m] of the lane lines and of both edges of the road."""
    one_side = [lane * LANE_WIDTH_M for lane in range(1, section.num_lanes + 1)] + [section.kerb_m]
    return [-across for across in one_side] + [0.0, *one_side]
