"""Bicycle racks beside the main street. nuScenes annotates the rack and the bicycles in it.

The detection benchmark leaves out bicycles whose centre is in a rack.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..object_row import ObjectRow, RowObject, place_objects, random_object
from ..road import SEED_OFFSET, Road
from ..snapshot import Snapshot, merge_snapshots

RACK_SPACING_M = 70.0
RACK_CLEARANCE_M = 8.0  # to the sidewalk of a cross street
BICYCLE_SPACING_M = 2.3
RACK_WIDTH_M, RACK_HEIGHT_M = 1.1, 1.5
BEHIND_TREES_M = 3.4  # distance from the sidewalk: between the trees and the houses
RACK_ROW = 300  # the first number of the identities; the world uses smaller numbers and some from 100 on per street


class BicycleRack:
    """A rack on one side of the main street and the bicycles in it, which stand one behind the other."""

    def __init__(self, seed: int, road: Road, side: int, number: int) -> None:
        """seed: of the scene.
        side: -1 right, +1 left.
        number: index of the rack along the street; may be negative.
        """
        rng = np.random.default_rng([seed, 9, side + 1, number + SEED_OFFSET])
        self.along_m = number * RACK_SPACING_M + float(rng.uniform(0.0, RACK_SPACING_M / 2))
        self.identity = (RACK_ROW, side, number)
        self.length_m = BICYCLE_SPACING_M * int(rng.integers(2, 5))
        self._row = ObjectRow(
            road.centre_line,
            side * (road.section.outside_m + BEHIND_TREES_M),
            0.0,
            1,
            1.0,
            lambda *_: (),
            lambda _: True,
        )
        starts = np.arange(BICYCLE_SPACING_M / 2, self.length_m, BICYCLE_SPACING_M) - self.length_m / 2
        self._bicycles = [
            random_object("bicycle", rng)._replace(along_m=self.along_m + start, identity=(*self.identity, index))
            for index, start in enumerate(starts.tolist())
        ]

    def bicycles(self) -> Snapshot:
        """The bicycles, in the global frame."""
        return place_objects(self._row, 0.0, self._bicycles)

    def box(self) -> NDArray[np.float64]:
        """The box (9,) of the rack, in the global frame."""
        size = (RACK_WIDTH_M, self.length_m, RACK_HEIGHT_M)
        rack = RowObject("bicycle_rack", self.along_m, 0.0, 0.0, size, self._bicycles[0].mesh, self.identity)
        return place_objects(self._row, 0.0, [rack]).boxes[0]


def racks_between(seed: int, road: Road, start_m: float, end_m: float) -> Iterator[BicycleRack]:
    """The racks between two arc lengths of the main street that are clear of its cross streets."""
    for number in range(int(start_m // RACK_SPACING_M), int(end_m // RACK_SPACING_M) + 1):
        for side in (-1, 1):
            rack = BicycleRack(seed, road, side, number)
            if start_m <= rack.along_m <= end_m and _is_clear_of_crossings(rack, road):
                yield rack


def with_bicycles(snapshot: Snapshot, racks: list[BicycleRack]) -> Snapshot:
    """A snapshot in the global frame with the bicycles of the racks added."""
    return merge_snapshots([snapshot, *(rack.bicycles() for rack in racks)])


def _is_clear_of_crossings(rack: BicycleRack, road: Road) -> bool:
    reach = rack.length_m / 2 + RACK_CLEARANCE_M
    streets = road.cross_streets(rack.along_m - 40.0, rack.along_m + 40.0)
    return all(abs(rack.along_m - street.along_m) > reach + street.section.outside_m for street in streets)
