"""The layers of a nuScenes map expansion file, version 1.3: polygons and lines over shared nodes."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .root_tables import Row, make_token

Array = NDArray[np.float64]

VERSION = "1.3"
LAYERS = (
    "polygon",
    "line",
    "node",
    "drivable_area",
    "road_segment",
    "road_block",
    "lane",
    "lane_connector",
    "ped_crossing",
    "walkway",
    "stop_line",
    "carpark_area",
    "road_divider",
    "lane_divider",
    "traffic_light",
)


class MapLayers:
    """The records of one location, by layer. All positions are in the global frame of the root."""

    def __init__(self, location: str) -> None:
        self._location = location
        self._layers: dict[str, list[Row]] = {name: [] for name in LAYERS}

    def add(self, layer: str, **fields: Any) -> str:
        """Add a record to a layer and return its token."""
        token = make_token(self._location, layer, len(self._layers[layer]))
        self._layers[layer].append({"token": token, **fields})
        return token

    def add_polygon(self, outline: Array) -> str:
        """Add a polygon without holes, outline (k, 2) [m], and return its token."""
        return self.add("polygon", exterior_node_tokens=self._add_nodes(outline), holes=[])

    def add_line(self, points: Array) -> str:
        """Add a line through points (k, 2) [m], and return its token."""
        return self.add("line", node_tokens=self._add_nodes(points))

    def node_tokens(self, line_token: str) -> list[str]:
        """The tokens of the nodes of the line that was added last."""
        line = self._layers["line"][-1]
        assert line["token"] == line_token
        return list(line["node_tokens"])

    def write(self, path: Path, canvas_m: tuple[float, float]) -> None:
        """Write the file.

        canvas_m: width and height of the map.
        """
        layers = {**self._layers, "arcline_path_3": {}, "connectivity": {}}
        path.write_text(json.dumps({"version": VERSION, "canvas_edge": canvas_m, **layers}, allow_nan=False))

    def _add_nodes(self, points: Array) -> list[str]:
        # Millimetres are enough, and keep the file small.
        return [self.add("node", x=x, y=y) for x, y in points.round(3).tolist()]
