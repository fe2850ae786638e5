"""Who and what is on a drawn street, and where at any time.

Everything stands on a track: a line at constant distance beside a street's centre line, whose things all move
along it at one rate. Things of one track therefore never meet, at any time. A track is furnished in blocks of
its length, each from its own random stream: the world is the same wherever a drive looks first.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh
from .road import LANE_WIDTH_M, CrossStreet, Curve, Road, beside
from .object_meshes import build_mesh

Array = NDArray[np.float64]
Rng = np.random.Generator
Size = tuple[float, float, float]

CLASS_SIZES_M: dict[str, Size] = {  # typical width, length, height, in the order of the classes
    "car": (1.95, 4.62, 1.73),
    "truck": (2.51, 6.93, 2.84),
    "construction_vehicle": (2.75, 6.37, 3.19),
    "bus": (2.84, 10.5, 3.47),
    "trailer": (2.80, 11.5, 3.87),
    "barrier": (2.53, 0.50, 0.98),
    "motorcycle": (0.77, 2.11, 1.47),
    "bicycle": (0.60, 1.70, 1.28),
    "pedestrian": (0.67, 0.73, 1.77),
    "traffic_cone": (0.41, 0.41, 1.07),
}
CLASSES = tuple(CLASS_SIZES_M)
WIDEST_M = 2.95
EGO_CLEARANCE_M = 11.0
CROSSING_CLEARANCE_M = 4.0
VIEW_M = 74.0  # just beyond the corners of the range, 51.2 m in x and y


class Thing(NamedTuple):
    """One thing on a track, relative to its track and block.

    along_m, across_m: the middle of its footprint; turn_rad: its heading against the track's.
    """

    name: str
    along_m: float
    across_m: float
    turn_rad: float
    size_m: Size
    mesh: Mesh
    identity: tuple[int, ...]


Furnish = Callable[[Rng, int], Iterable[Thing]]  # gives a block's things, from its random stream and index
IsKept = Callable[[Thing], bool]


@dataclass(frozen=True)
class Track:
    """A line beside a centre line: rate_mps along it, forward where +1 and against it where -1."""

    curve: Curve
    across_m: float
    rate_mps: float
    direction: int
    block_m: float
    furnish: Furnish
    is_kept: IsKept


@dataclass(frozen=True)
class Scene:
    """What stands where at one moment.

    boxes: (D, 9) x y z w l h yaw vx vy, all in one frame; names: a class, or what scenery it is;
    identities: the same for the same thing at another time.
    """

    boxes: Array
    names: tuple[str, ...]
    meshes: tuple[Mesh, ...]
    identities: tuple[tuple[int, ...], ...]

    def is_actor(self) -> NDArray[np.bool_]:
        """(D,) true for things of the ten classes, false for scenery."""
        return np.array([name in CLASS_SIZES_M for name in self.names], dtype=bool)


class World:
    """The tracks of one drive. The ego is on its own lane's track, at along = 0 of it."""

    def __init__(self, seed: int, road: Road) -> None:
        rng = np.random.default_rng([seed, 3])
        self._seed = seed
        self.road = road
        self.ego_rate_mps = rng.uniform(5.0, 12.0)
        self.ego_across_m = -(road.section.num_lanes - 0.5) * LANE_WIDTH_M
        self.tracks = tuple(self._main_tracks(rng))
        self._furnished = lru_cache(maxsize=512)(self._furnish)
        self._cross_traffic = lru_cache(maxsize=32)(self._furnish_cross_street)

    def ego_pose(self, time_s: float) -> tuple[Array, float]:
        """Position (2,) [m] and heading [rad] of the ego in the global frame, `time_s` after the start."""
        along = np.array([self.ego_rate_mps * time_s])
        position = self.road.curve.place(along, self.ego_across_m)[0]
        return position, float(self.road.curve.heading(along)[0])

    def scene(self, time_s: float) -> Scene:
        """Everything within view of the ego, in the global frame, `time_s` after the start."""
        ego = self.ego_rate_mps * time_s
        placed = [_place(track, time_s, self._things(index, time_s, ego)) for index, track in enumerate(self.tracks)]
        for street in self.road.cross_streets(ego - VIEW_M, ego + VIEW_M):
            placed += [_place(track, time_s, things) for track, things in self._cross_traffic(street)]
        return _within(VIEW_M, self.ego_pose(time_s)[0], _merge(placed))

    def _things(self, index: int, time_s: float, ego_m: float) -> list[Thing]:
        track = self.tracks[index]
        start = ego_m - VIEW_M - track.rate_mps * time_s
        blocks = range(int(start // track.block_m), int((start + 2 * VIEW_M) // track.block_m) + 1)
        return [thing for block in blocks for thing in self._furnished(index, block)]

    def _furnish(self, track_index: int, block: int) -> tuple[Thing, ...]:
        track = self.tracks[track_index]
        rng = np.random.default_rng([self._seed, 4, track_index, block + 2**31])
        things = (
            thing._replace(along_m=thing.along_m + block * track.block_m, identity=(track_index, block, number))
            for number, thing in enumerate(track.furnish(rng, block))
        )
        return tuple(thing for thing in things if track.is_kept(thing))

    def _main_tracks(self, rng: Rng) -> Iterator[Track]:
        section, curve = self.road.section, self.road.curve

        def track(across: float, rate: float, block: float, furnish: Furnish, is_kept: IsKept) -> Track:
            direction = -1 if (across > 0 if rate == 0 else rate < 0) else 1
            return Track(curve, across, rate, direction, block, furnish, is_kept)

        for lane in range(section.num_lanes):
            across = (lane + 0.5) * LANE_WIDTH_M
            is_ego_lane = lane == section.num_lanes - 1
            rate = self.ego_rate_mps if is_ego_lane else self.ego_rate_mps + rng.uniform(1.0, 4.0)
            yield track(-across, rate, 190.0, _traffic, _off_the_ego if is_ego_lane else _always)
            yield track(across, -rng.uniform(5.0, 12.0), 190.0, _traffic, _always)
        works_phase = int(rng.integers(2))
        for side in (-1, 1):
            kerbside = _Kerbside(side, works_phase, section.parking_m)
            kerb = section.kerb_m
            beside = side * (section.lanes_m + section.parking_m / 2)
            yield track(beside, 0.0, 55.0, kerbside, self._off_crossings)
            yield track(side * (kerb + 0.8), -side * rng.uniform(3.0, 5.0), 60.0, _cyclists, _always)
            yield track(side * (kerb + 1.9), -side * rng.uniform(0.9, 1.5), 44.0, _walkers, _always)
            yield track(side * (kerb + 2.9), side * rng.uniform(0.9, 1.5), 44.0, _walkers, _always)
            yield track(side * (kerb + 3.9), 0.0, 40.0, _idlers, self._off_crossings)
            yield track(side * (section.outside_m + 1.3), 0.0, 36.0, _greenery, self._off_crossings)
            yield track(side * (section.outside_m + 10.0), 0.0, 60.0, _houses, self._off_crossings)

    def _off_crossings(self, thing: Thing) -> bool:
        reach = thing.size_m[1] / 2 + CROSSING_CLEARANCE_M + (3.0 if thing.name == "house" else 0.0)
        streets = self.road.cross_streets(thing.along_m - 40.0, thing.along_m + 40.0)
        return all(abs(thing.along_m - street.along_m) > reach + street.section.outside_m for street in streets)

    def _furnish_cross_street(self, street: CrossStreet) -> tuple[tuple[Track, tuple[Thing, ...]], ...]:
        """Traffic that leaves the crossing long before the ego comes, or reaches it long after."""
        rng = np.random.default_rng([self._seed, 5, street.number + 2**31])
        ego_time = street.along_m / self.ego_rate_mps
        lead = (VIEW_M - 25.0) / self.ego_rate_mps
        tracks = []
        for number, (side, leaves) in enumerate((s, leaving) for s in (-1, 1) for leaving in (True, False)):
            if rng.random() < 0.3:
                continue
            waits = not leaves and rng.random() < 0.5
            speed = 0.0 if waits else rng.uniform(2.5, 5.0)
            direction = side if leaves else -side
            name = str(rng.choice(["car", "car", "car", "truck", "bus", "motorcycle"]))
            thing = _thing(name, rng)._replace(identity=(100 + street.number % 2**20, number))
            nearest = self.road.section.outside_m + 1.5 + thing.size_m[1] / 2
            along_at_zero = side * (nearest + speed * lead) - direction * speed * ego_time
            track = Track(
                street.curve, -direction * LANE_WIDTH_M / 2, direction * speed, direction, 1.0, _nothing, _always
            )
            tracks.append((track, (thing._replace(along_m=along_at_zero),)))
        return tuple(tracks)


class _Kerbside:
    """The parking strip on one side: parked vehicles, and roadworks in every second block."""

    def __init__(self, side: int, works_phase: int, width_m: float) -> None:
        self._side = side
        self._works_phase = works_phase
        self._width_m = width_m

    def __call__(self, rng: Rng, block: int) -> Iterator[Thing]:
        if (block + (self._side > 0)) % 2 == self._works_phase:
            return self._roadworks(rng)
        return self._parked(rng)

    def _parked(self, rng: Rng) -> Iterator[Thing]:
        names = ["car"] * int(rng.integers(2, 5)) + ["motorcycle", str(rng.choice(["truck", "trailer", "bus"]))]
        for thing in _queue(names, rng, 55.0, gap_m=1.2):
            yield thing._replace(across_m=rng.uniform(-0.08, 0.08), turn_rad=np.pi if rng.random() < 0.12 else 0.0)

    def _roadworks(self, rng: Rng) -> Iterator[Thing]:
        """Cones lead in and out; between them barriers, a worker and a digger."""
        edge = -self._side * (self._width_m / 2 - 0.35)
        for step in range(3):
            for along in (4.0 + 5.0 * step, 52.0 - 4.0 * step):
                across = edge * (step - 1)
                yield _thing("traffic_cone", rng)._replace(along_m=along, across_m=across)
        for step in range(4):
            yield _thing("barrier", rng)._replace(along_m=18.5 + 3.0 * step, across_m=edge, turn_rad=np.pi / 2)
        yield _thing("pedestrian", rng)._replace(
            along_m=rng.uniform(19.0, 27.0), across_m=-edge * 0.4, turn_rad=rng.uniform(-np.pi, np.pi)
        )
        yield _thing("construction_vehicle", rng)._replace(along_m=35.0, turn_rad=np.pi if rng.random() < 0.3 else 0.0)
        yield _thing("barrier", rng)._replace(along_m=41.0)


def _traffic(rng: Rng, block: int) -> Iterator[Thing]:
    """A lane's moving vehicles; a trailer comes right behind its truck."""
    names = ["car"] * 6 + ["motorcycle", "truck", "bus", "articulated"]
    return _queue(names, rng, 190.0, gap_m=5.0)


def _cyclists(rng: Rng, block: int) -> Iterator[Thing]:
    return _queue(["bicycle"] * int(rng.integers(1, 3)), rng, 60.0, gap_m=3.0)


def _walkers(rng: Rng, block: int) -> Iterator[Thing]:
    return _queue(["pedestrian"] * int(rng.integers(0, 3)), rng, 44.0, gap_m=1.2)


def _idlers(rng: Rng, block: int) -> Iterator[Thing]:
    """People who stand about."""
    for thing in _queue(["pedestrian"] * int(rng.integers(0, 2)), rng, 40.0, gap_m=1.2):
        yield thing._replace(turn_rad=rng.uniform(-np.pi, np.pi))


def _greenery(rng: Rng, block: int) -> Iterator[Thing]:
    for along in (0.0, 12.0, 24.0):
        if rng.random() < 0.75:
            crown = rng.uniform(2.6, 3.4)
            yield _scenery("tree", (crown, crown, rng.uniform(4.5, 7.5)), along + rng.uniform(4.0, 6.0), rng)
    yield _scenery("lamp", (1.6, 0.3, rng.uniform(6.5, 7.0)), 11.0, rng)


def _houses(rng: Rng, block: int) -> Iterator[Thing]:
    along = rng.uniform(0.0, 3.0)
    while (length := rng.uniform(10.0, 19.0)) < 59.0 - along:
        if rng.random() < 0.85:
            size = (rng.uniform(9.0, 12.0), length, rng.uniform(5.0, 17.0))
            yield _scenery("house", size, along + length / 2, rng)
        along += length + rng.choice([0.4, rng.uniform(2.0, 7.0)])


def _nothing(rng: Rng, block: int) -> Iterator[Thing]:
    return iter(())


def _always(thing: Thing) -> bool:
    return True


def _off_the_ego(thing: Thing) -> bool:
    return abs(thing.along_m) > EGO_CLEARANCE_M + thing.size_m[1] / 2


def _queue(names: Sequence[str], rng: Rng, length_m: float, gap_m: float) -> Iterator[Thing]:
    """Things in random order one behind the other over `length_m`, at least `gap_m` apart."""
    rows = [_rows(name, rng) for name in rng.permutation(names).tolist()]
    lengths = [sum(thing.size_m[1] + 1.0 for thing in row) for row in rows]
    slack = length_m - sum(lengths) - gap_m * len(rows)
    gaps = gap_m + max(slack, 0.0) * rng.dirichlet(np.full(len(rows) + 1, 1.5))[:-1]
    along = 0.0
    for row, gap in zip(rows, gaps, strict=True):
        along += gap
        for thing in row:
            yield thing._replace(along_m=along + 0.5 + thing.size_m[1] / 2)
            along += thing.size_m[1] + 1.0


def _rows(name: str, rng: Rng) -> list[Thing]:
    """The things that stand for one name, from rear to front."""
    return [_thing(part, rng) for part in (("trailer", "truck") if name == "articulated" else (name,))]


def _thing(name: str, rng: Rng) -> Thing:
    size = np.array(CLASS_SIZES_M[name]) * np.clip(rng.normal(1.0, 0.05, 3), 0.9, 1.1)
    size[0] = min(size[0], WIDEST_M)
    size_m = (float(size[0]), float(size[1]), float(size[2]))
    return Thing(name, 0.0, 0.0, 0.0, size_m, build_mesh(name, size_m, rng), ())


def _scenery(name: str, size_m: Size, along_m: float, rng: Rng) -> Thing:
    return Thing(name, along_m, 0.0, 0.0, size_m, build_mesh(name, size_m, rng), ())


def _place(track: Track, time_s: float, things: Sequence[Thing]) -> Scene:
    """A track's things in the global frame, facing the track's direction."""
    along = np.array([thing.along_m for thing in things]) + track.rate_mps * time_s
    across = track.across_m + np.array([thing.across_m for thing in things])
    boxes = np.zeros((len(things), 9))
    x, y, heading, curvature = track.curve.at(along).T
    boxes[:, :2] = beside(x, y, heading, across)
    boxes[:, 3:6] = np.array([thing.size_m for thing in things]).reshape(-1, 3)
    boxes[:, 2] = boxes[:, 5] / 2
    speed = track.rate_mps * (1 - curvature * across)
    boxes[:, 6] = heading + (0.0 if track.direction > 0 else np.pi) + [thing.turn_rad for thing in things]
    boxes[:, 7], boxes[:, 8] = speed * np.cos(heading), speed * np.sin(heading)
    return Scene(
        boxes,
        tuple(thing.name for thing in things),
        tuple(thing.mesh for thing in things),
        tuple(thing.identity for thing in things),
    )


def _merge(scenes: Sequence[Scene]) -> Scene:
    return Scene(
        np.concatenate([scene.boxes for scene in scenes]),
        sum((scene.names for scene in scenes), ()),
        sum((scene.meshes for scene in scenes), ()),
        sum((scene.identities for scene in scenes), ()),
    )


def _within(reach_m: float, position_m: Array, scene: Scene) -> Scene:
    near = np.flatnonzero(np.linalg.norm(scene.boxes[:, :2] - position_m, axis=1) < reach_m)
    return Scene(
        scene.boxes[near],
        tuple(scene.names[i] for i in near),
        tuple(scene.meshes[i] for i in near),
        tuple(scene.identities[i] for i in near),
    )
