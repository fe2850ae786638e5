"""The places of the scenes on the maps: each scene has a separate area in one of the four locations of nuScenes."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..drive import KEY_FRAME_INTERVAL_S, TOP_SPEED_M_S
from ..road import Road

Array = NDArray[np.float64]

LOCATIONS = ("boston-seaport", "singapore-hollandvillage", "singapore-onenorth", "singapore-queenstown")
MAPPED_M = 120.0  # length of the main street that is mapped before the start and after the end of a drive
MARGIN_M = 50.0  # around each scene
CANVAS_WIDTH_M = 3000.0


class Place(NamedTuple):
    """The place of a scene.

    location: one of `LOCATIONS`.
    road: the streets of the scene.
    ends_m: the arc lengths of the main street between which it is mapped.
    origin_m: (2,) of the scene's world in the global frame of the root.
    """

    location: str
    road: Road
    ends_m: tuple[float, float]
    origin_m: Array


class MapLayout:
    """Places scenes in rows from left to right on each map, all at positive coordinates."""

    def __init__(self) -> None:
        self._next_m = {location: np.full(2, MARGIN_M) for location in LOCATIONS}  # where the next scene is placed
        self._row_height_m = dict.fromkeys(LOCATIONS, 0.0)
        self._sizes_m = {location: np.zeros(2) for location in LOCATIONS}

    def place(self, number: int, seed: int, num_frames: int) -> Place:
        """Place scene `number`, counted from 0."""
        location = LOCATIONS[number % len(LOCATIONS)]
        length = TOP_SPEED_M_S * KEY_FRAME_INTERVAL_S * num_frames
        road, ends = Road(seed, length), (-MAPPED_M, length + MAPPED_M)
        points = np.concatenate([patch.outline for patch in road.ground_patches(*ends)])
        lower, size = points.min(axis=0), np.ptp(points, axis=0)
        corner = self._next_corner(location, size)
        return Place(location, road, ends, corner - lower)

    def canvas_m(self, location: str) -> tuple[float, float]:
        """Width and height of a map."""
        width, height = np.ceil(self._sizes_m[location] + MARGIN_M).tolist()
        return width, height

    def _next_corner(self, location: str, size_m: Array) -> Array:
        """The lower corner (2,) of the area of the next scene of a location."""
        corner = self._next_m[location]
        if corner[0] > MARGIN_M and corner[0] + size_m[0] > CANVAS_WIDTH_M:
            corner = np.array([MARGIN_M, corner[1] + self._row_height_m[location] + MARGIN_M])
            self._row_height_m[location] = 0.0
        self._row_height_m[location] = max(self._row_height_m[location], float(size_m[1]))
        self._next_m[location] = corner + np.array([size_m[0] + MARGIN_M, 0.0])
        self._sizes_m[location] = np.maximum(self._sizes_m[location], corner + size_m)
        return corner
