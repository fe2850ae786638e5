"""The streets of a scene as layers of the map.

The dividers are the painted lines: the centre lines are road dividers; the lines between lanes, and between the outer
lane and the parking strip, are lane dividers. Kerbs are no dividers. In the masks of `synthetic:SEED` they are lane
boundaries too.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..centre_line import STRIP_STEP_M, CentreLine
from ..road import LANE_WIDTH_M, CrossSection, CrossStreet, Road
from .map_layers import MapLayers

Array = NDArray[np.float64]


class RoadMap:
    """Adds the streets of one scene to the layers of its location."""

    def __init__(self, layers: MapLayers, road: Road, origin_m: Array, start_m: float, end_m: float) -> None:
        """origin_m: (2,) of the scene's world in the global frame of the root.
        start_m, end_m: the arc lengths of the main street between which it is mapped, with its cross streets.
        """
        self._layers = layers
        self._road = road
        self._origin_m = origin_m
        self._ends_m = (start_m, end_m)
        self._crossings = road.cross_streets(start_m, end_m)

    def add(self) -> None:
        """Add all layers."""
        area = self._layers.add("drivable_area", polygon_tokens=[self._polygon(*strip) for strip in self._streets()])
        self._add_main_street(area)
        for crossing in self._crossings:
            self._add_cross_street(crossing, area)

    def _streets(self) -> Iterator[tuple[CentreLine, float, float, float, float]]:
        """Each street from kerb to kerb, as the arguments of `_polygon`."""
        kerb = self._road.section.kerb_m
        yield self._road.centre_line, *self._ends_m, -kerb, kerb
        for crossing in self._crossings:
            yield crossing.centre_line, *crossing.centre_line.ends_m, -crossing.section.kerb_m, crossing.section.kerb_m

    def _add_main_street(self, area: str) -> None:
        centre_line, section = self._road.centre_line, self._road.section
        for start, end in self._road.stretches(self._crossings, *self._ends_m):
            segment = self._add_segment(centre_line, start, end, section, area)
            for side in (-1, 1):
                for lane in range(1, section.num_lanes + 1):
                    self._add_lane_divider(centre_line, start, end, side * lane * LANE_WIDTH_M)
                near, far = sorted((side * section.lanes_m, side * section.kerb_m))
                self._layers.add(
                    "carpark_area",
                    polygon_token=self._polygon(centre_line, start, end, near, far),
                    orientation=0.0,
                    road_block_token=segment,
                )

    def _add_cross_street(self, crossing: CrossStreet, area: str) -> None:
        centre_line, section = crossing.centre_line, crossing.section
        for start, end in self._road.cross_street_stretches(crossing):
            self._add_segment(centre_line, start, end, section, area)
        mouth = self._road.section.kerb_m
        junction = self._layers.add(
            "road_segment",
            polygon_token=self._polygon(centre_line, -mouth, mouth, -section.kerb_m, section.kerb_m),
            is_intersection=True,
            drivable_area_token=area,
        )
        for near, far in self._road.crosswalks(crossing):
            self._layers.add(
                "ped_crossing",
                polygon_token=self._polygon(centre_line, near, far, -section.kerb_m, section.kerb_m),
                road_segment_token=junction,
            )

    def _add_segment(self, line: CentreLine, start: float, end: float, section: CrossSection, area: str) -> str:
        """Add a stretch of a street, with its lanes, walkways and centre line. Returns the token of a road block."""
        segment = self._layers.add(
            "road_segment",
            polygon_token=self._polygon(line, start, end, -section.kerb_m, section.kerb_m),
            is_intersection=False,
            drivable_area_token=area,
        )
        self._layers.add("road_divider", line_token=self._line(line, start, end, 0.0), road_segment_token=segment)
        for side in (-1, 1):
            block = self._add_lanes(line, start, end, section, side, segment)
            near, far = sorted((side * section.kerb_m, side * section.outside_m))
            self._layers.add("walkway", polygon_token=self._polygon(line, start, end, near, far))
        return block

    def _add_lanes(
        self, line: CentreLine, start: float, end: float, section: CrossSection, side: int, segment: str
    ) -> str:
        """Add the block of lanes in one direction, and return its token. Traffic keeps to the right."""
        first, last = (start, end) if side < 0 else (end, start)
        across = sorted((0.0, side * section.lanes_m))
        block = self._layers.add(
            "road_block",
            polygon_token=self._polygon(line, start, end, *across),
            from_edge_line_token=self._edge(line, first, *across),
            to_edge_line_token=self._edge(line, last, *across),
            road_segment_token=segment,
        )
        for lane in range(section.num_lanes):
            across = sorted((side * lane * LANE_WIDTH_M, side * (lane + 1) * LANE_WIDTH_M))
            self._layers.add(
                "lane",
                polygon_token=self._polygon(line, start, end, *across),
                lane_type="CAR",
                from_edge_line_token=self._edge(line, first, *across),
                to_edge_line_token=self._edge(line, last, *across),
                left_lane_divider_segments=[],
                right_lane_divider_segments=[],
            )
        return block

    def _add_lane_divider(self, line: CentreLine, start: float, end: float, across: float) -> None:
        token = self._line(line, start, end, across)
        segments = [
            {"node_token": node, "segment_type": "SINGLE_SOLID_WHITE"} for node in self._layers.node_tokens(token)
        ]
        self._layers.add("lane_divider", line_token=token, lane_divider_segments=segments)

    def _polygon(self, line: CentreLine, start: float, end: float, right: float, left: float) -> str:
        return self._layers.add_polygon(line.strip(start, end, right, left) + self._origin_m)

    def _line(self, line: CentreLine, start: float, end: float, across: float) -> str:
        along = np.linspace(start, end, max(1, int(np.ceil((end - start) / STRIP_STEP_M))) + 1)
        return self._layers.add_line(line.positions(along, across) + self._origin_m)

    def _edge(self, line: CentreLine, along: float, right: float, left: float) -> str:
        """Add the line across a street at an arc length, and return its token."""
        points = line.positions(np.full(2, along), np.array([right, left]))
        return self._layers.add_line(points + self._origin_m)
