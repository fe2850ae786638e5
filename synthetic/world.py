"""The synthetic world of one drive: its road, its objects and the ego pose, at any time.

Every object belongs to a row beside the centre line of a street. All objects of a row move at the same rate, so they
never collide. Rows are generated in blocks. Each block has its own random stream, so the world does not depend on the
order in which its parts are generated.
"""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from .object_row import GenerateBlock, IsKept, ObjectRow, Rng, RowObject, place_objects, random_object
from .road import LANE_WIDTH_M, SEED_OFFSET, CrossStreet, Road
from .row_blocks import (
    CYCLIST_BLOCK_M,
    GREENERY_BLOCK_M,
    HOUSE_BLOCK_M,
    KERBSIDE_BLOCK_M,
    STANDING_BLOCK_M,
    TRAFFIC_BLOCK_M,
    WALKING_BLOCK_M,
    KerbsideBlocks,
    cyclists,
    houses,
    moving_vehicles,
    standing_pedestrians,
    trees_and_lamps,
    walking_pedestrians,
)
from .snapshot import Snapshot, merge_snapshots

Array = NDArray[np.float64]

EGO_CLEARANCE_M = 11.0  # free length of the lane ahead of the ego's centre, and behind it
CROSSING_CLEARANCE_M = 4.0  # from stationary objects to the sidewalk of a cross street
VIEW_M = 74.0  # just beyond the corners of the range, 51.2 m in x and y


class World:
    """The ego, the object rows along the main street, and the traffic on the cross streets.

    The ego moves with the row of its lane, and always has along_m = 0 in this row.
    """

    def __init__(self, seed: int, road: Road) -> None:
        """seed: of the objects and of their motion."""
        rng = np.random.default_rng([seed, 3])
        self._seed = seed
        self.road = road
        self.ego_rate_m_s = rng.uniform(5.0, 12.0)
        self.ego_across_m = -(road.section.num_lanes - 0.5) * LANE_WIDTH_M
        self._rows = tuple(self._main_street_rows(rng))
        self._block = lru_cache(maxsize=512)(self._generate_block)
        self._cross_traffic = lru_cache(maxsize=32)(self._generate_cross_traffic)

    def ego_pose(self, time_s: float) -> tuple[Array, float]:
        """Position (2,) [m] and heading [rad] of the ego in the global frame, `time_s` after the start."""
        along = np.array([self.ego_rate_m_s * time_s])
        position = self.road.centre_line.positions(along, self.ego_across_m)[0]
        return position, float(self.road.centre_line.headings(along)[0])

    def snapshot(self, time_s: float) -> Snapshot:
        """All objects within `VIEW_M` of the ego, in the global frame, `time_s` after the start."""
        ego = self.ego_rate_m_s * time_s
        snapshots = [
            place_objects(row, time_s, self._row_objects(index, time_s, ego)) for index, row in enumerate(self._rows)
        ]
        for street in self.road.cross_streets(ego - VIEW_M, ego + VIEW_M):
            snapshots += [place_objects(row, time_s, objects) for row, objects in self._cross_traffic(street)]
        return merge_snapshots(snapshots).within(VIEW_M, self.ego_pose(time_s)[0])

    def _row_objects(self, row_index: int, time_s: float, ego_m: float) -> list[RowObject]:
        """The objects of all blocks of a row that are at least partly in view."""
        row = self._rows[row_index]
        start = ego_m - VIEW_M - row.rate_m_s * time_s
        blocks = range(int(start // row.block_m), int((start + 2 * VIEW_M) // row.block_m) + 1)
        return [item for block in blocks for item in self._block(row_index, block)]

    def _generate_block(self, row_index: int, block: int) -> tuple[RowObject, ...]:
        """The objects of one block, with arc lengths counted from the start of the row, and with identities."""
        row = self._rows[row_index]
        rng = np.random.default_rng([self._seed, 4, row_index, block + SEED_OFFSET])
        objects = (
            item._replace(along_m=item.along_m + block * row.block_m, identity=(row_index, block, number))
            for number, item in enumerate(row.generate_block(rng, block))
        )
        return tuple(item for item in objects if row.is_kept(item))

    def _main_street_rows(self, rng: Rng) -> Iterator[ObjectRow]:
        """The rows of the main street: lanes, parking strips, cyclists, pedestrians and scenery, on both sides."""
        section = self.road.section

        def row(across: float, rate: float, block: float, generate: GenerateBlock, is_kept: IsKept) -> ObjectRow:
            # Stationary objects face in the direction of the traffic on their side, which keeps to the right.
            direction = -1 if (across > 0 if rate == 0 else rate < 0) else 1
            return ObjectRow(self.road.centre_line, across, rate, direction, block, generate, is_kept)

        for lane in range(section.num_lanes):
            across = (lane + 0.5) * LANE_WIDTH_M
            is_ego_lane = lane == section.num_lanes - 1
            rate = self.ego_rate_m_s if is_ego_lane else self.ego_rate_m_s + rng.uniform(1.0, 4.0)
            yield row(-across, rate, TRAFFIC_BLOCK_M, moving_vehicles, _is_clear_of_ego if is_ego_lane else _always)
            yield row(across, -rng.uniform(5.0, 12.0), TRAFFIC_BLOCK_M, moving_vehicles, _always)
        roadworks_phase = int(rng.integers(2))
        is_clear = self._is_clear_of_crossings
        for side in (-1, 1):
            kerbside = KerbsideBlocks(side, roadworks_phase, section.parking_m)
            parking = section.lanes_m + section.parking_m / 2
            kerb, outside = section.kerb_m, section.outside_m
            yield row(side * parking, 0.0, KERBSIDE_BLOCK_M, kerbside, is_clear)
            yield row(side * (kerb + 0.8), -side * rng.uniform(3.0, 5.0), CYCLIST_BLOCK_M, cyclists, _always)
            for across, direction in ((kerb + 1.9, -side), (kerb + 2.9, side)):
                rate = direction * rng.uniform(0.9, 1.5)
                yield row(side * across, rate, WALKING_BLOCK_M, walking_pedestrians, _always)
            yield row(side * (kerb + 3.9), 0.0, STANDING_BLOCK_M, standing_pedestrians, is_clear)
            yield row(side * (outside + 1.3), 0.0, GREENERY_BLOCK_M, trees_and_lamps, is_clear)
            yield row(side * (outside + 10.0), 0.0, HOUSE_BLOCK_M, houses, is_clear)

    def _is_clear_of_crossings(self, item: RowObject) -> bool:
        reach = item.size_m[1] / 2 + CROSSING_CLEARANCE_M + (3.0 if item.name == "house" else 0.0)
        streets = self.road.cross_streets(item.along_m - 40.0, item.along_m + 40.0)
        return all(abs(item.along_m - street.along_m) > reach + street.section.outside_m for street in streets)

    def _generate_cross_traffic(self, street: CrossStreet) -> tuple[tuple[ObjectRow, tuple[RowObject, ...]], ...]:
        """Up to four vehicles on a cross street, each in its own row.

        A vehicle leaves the crossing long before the ego arrives, or reaches it long after, so it never meets the ego.
        """
        rng = np.random.default_rng([self._seed, 5, street.number + SEED_OFFSET])
        ego_arrival_s = street.along_m / self.ego_rate_m_s
        margin_s = (VIEW_M - 25.0) / self.ego_rate_m_s
        traffic = []
        for number, (side, leaves) in enumerate((s, leaving) for s in (-1, 1) for leaving in (True, False)):
            if rng.random() < 0.3:
                continue
            waits = not leaves and rng.random() < 0.5
            speed = 0.0 if waits else rng.uniform(2.5, 5.0)
            direction = side if leaves else -side
            name = str(rng.choice(["car", "car", "car", "truck", "bus", "motorcycle"]))
            vehicle = random_object(name, rng)._replace(identity=(100 + street.number % 2**20, number))
            # The vehicle is at this distance from the crossing `margin_s` before or after the ego arrives there.
            nearest = self.road.section.outside_m + 1.5 + vehicle.size_m[1] / 2
            along_at_start = side * (nearest + speed * margin_s) - direction * speed * ego_arrival_s
            across, rate = -direction * LANE_WIDTH_M / 2, direction * speed
            row = ObjectRow(street.centre_line, across, rate, direction, 1.0, _empty_block, _always)
            traffic.append((row, (vehicle._replace(along_m=along_at_start),)))
        return tuple(traffic)


def _is_clear_of_ego(item: RowObject) -> bool:
    return abs(item.along_m) > EGO_CLEARANCE_M + item.size_m[1] / 2


def _always(item: RowObject) -> bool:
    return True


def _empty_block(rng: Rng, block: int) -> Iterator[RowObject]:
    return iter(())
