"""Generators of the blocks of object rows: traffic, parked vehicles, roadworks, people and scenery."""

from collections.abc import Iterator, Sequence

import numpy as np

from .object_row import Rng, RowObject, random_object, scenery_object

TRAFFIC_BLOCK_M = 190.0
KERBSIDE_BLOCK_M = 55.0
CYCLIST_BLOCK_M = 60.0
WALKING_BLOCK_M = 44.0
STANDING_BLOCK_M = 40.0
GREENERY_BLOCK_M = 36.0
HOUSE_BLOCK_M = 60.0


def moving_vehicles(rng: Rng, block: int) -> Iterator[RowObject]:
    """The vehicles of a traffic lane. A trailer is directly behind its truck."""
    names = ["car"] * 6 + ["motorcycle", "truck", "bus", "articulated"]
    return _distribute(names, rng, TRAFFIC_BLOCK_M, gap_m=5.0)


class KerbsideBlocks:
    """The parking strip on one side of the street: parked vehicles, and roadworks in every second block."""

    def __init__(self, side: int, roadworks_phase: int, width_m: float) -> None:
        """side: -1 right, +1 left.
        roadworks_phase: 0 or 1; which blocks have roadworks, the even or the odd ones.
        width_m: of the parking strip.
        """
        self._side = side
        self._roadworks_phase = roadworks_phase
        self._width_m = width_m

    def __call__(self, rng: Rng, block: int) -> Iterator[RowObject]:
        if (block + (self._side > 0)) % 2 == self._roadworks_phase:
            return self._roadworks(rng)
        return self._parked_vehicles(rng)

    def _parked_vehicles(self, rng: Rng) -> Iterator[RowObject]:
        names = ["car"] * int(rng.integers(2, 5)) + ["motorcycle", str(rng.choice(["truck", "trailer", "bus"]))]
        for item in _distribute(names, rng, KERBSIDE_BLOCK_M, gap_m=1.2):
            yield item._replace(across_m=rng.uniform(-0.08, 0.08), turn_rad=np.pi if rng.random() < 0.12 else 0.0)

    def _roadworks(self, rng: Rng) -> Iterator[RowObject]:
        """Cones at both ends; between them barriers, a worker and an excavator."""
        edge = -self._side * (self._width_m / 2 - 0.35)
        for step in range(3):
            for along in (4.0 + 5.0 * step, 52.0 - 4.0 * step):
                across = edge * (step - 1)
                yield random_object("traffic_cone", rng)._replace(along_m=along, across_m=across)
        for step in range(4):
            yield random_object("barrier", rng)._replace(along_m=18.5 + 3.0 * step, across_m=edge, turn_rad=np.pi / 2)
        yield random_object("pedestrian", rng)._replace(
            along_m=rng.uniform(19.0, 27.0), across_m=-edge * 0.4, turn_rad=rng.uniform(-np.pi, np.pi)
        )
        excavator = random_object("construction_vehicle", rng)
        yield excavator._replace(along_m=35.0, turn_rad=np.pi if rng.random() < 0.3 else 0.0)
        yield random_object("barrier", rng)._replace(along_m=41.0)


def cyclists(rng: Rng, block: int) -> Iterator[RowObject]:
    """One or two cyclists."""
    return _distribute(["bicycle"] * int(rng.integers(1, 3)), rng, CYCLIST_BLOCK_M, gap_m=3.0)


def walking_pedestrians(rng: Rng, block: int) -> Iterator[RowObject]:
    """Up to two pedestrians, who face along the row."""
    return _distribute(["pedestrian"] * int(rng.integers(0, 3)), rng, WALKING_BLOCK_M, gap_m=1.2)


def standing_pedestrians(rng: Rng, block: int) -> Iterator[RowObject]:
    """At most one pedestrian, who faces in any direction."""
    for item in _distribute(["pedestrian"] * int(rng.integers(0, 2)), rng, STANDING_BLOCK_M, gap_m=1.2):
        yield item._replace(turn_rad=rng.uniform(-np.pi, np.pi))


def trees_and_lamps(rng: Rng, block: int) -> Iterator[RowObject]:
    """Up to three trees, and a lamp."""
    for along in (0.0, 12.0, 24.0):
        if rng.random() < 0.75:
            crown = rng.uniform(2.6, 3.4)
            yield scenery_object("tree", (crown, crown, rng.uniform(4.5, 7.5)), along + rng.uniform(4.0, 6.0), rng)
    yield scenery_object("lamp", (1.6, 0.3, rng.uniform(6.5, 7.0)), 11.0, rng)


def houses(rng: Rng, block: int) -> Iterator[RowObject]:
    """Houses side by side, some with a gap between them."""
    along = rng.uniform(0.0, 3.0)
    while (length := rng.uniform(10.0, 19.0)) < HOUSE_BLOCK_M - 1.0 - along:
        if rng.random() < 0.85:
            size = (rng.uniform(9.0, 12.0), length, rng.uniform(5.0, 17.0))
            yield scenery_object("house", size, along + length / 2, rng)
        along += length + rng.choice([0.4, rng.uniform(2.0, 7.0)])


def _distribute(names: Sequence[str], rng: Rng, length_m: float, gap_m: float) -> Iterator[RowObject]:
    """Objects of these names in random order, one behind the other over `length_m`, at least `gap_m` apart."""
    groups = [_random_group(name, rng) for name in rng.permutation(names).tolist()]
    lengths = [sum(item.size_m[1] + 1.0 for item in group) for group in groups]
    slack = length_m - sum(lengths) - gap_m * len(groups)
    gaps = gap_m + max(slack, 0.0) * rng.dirichlet(np.full(len(groups) + 1, 1.5))[:-1]
    along = 0.0
    for group, gap in zip(groups, gaps, strict=True):
        along += gap
        for item in group:
            yield item._replace(along_m=along + 0.5 + item.size_m[1] / 2)
            along += item.size_m[1] + 1.0


def _random_group(name: str, rng: Rng) -> list[RowObject]:
    """The objects of one name from rear to front: "articulated" is a trailer and a truck, any other is one object."""
    return [random_object(part, rng) for part in (("trailer", "truck") if name == "articulated" else (name,))]
