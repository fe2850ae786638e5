"""Small map expansion files, written by hand."""

import json
from pathlib import Path

import numpy as np

OTHER_LAYERS = (
    "road_segment", "road_block", "lane", "lane_connector", "ped_crossing", "walkway", "stop_line", "carpark_area",
    "traffic_light",
)  # fmt: skip


class MapFile:
    """The layers of a map expansion file. Tests change them, and write them."""

    def __init__(self) -> None:
        names = ("node", "polygon", "line", "drivable_area", "road_divider", "lane_divider", *OTHER_LAYERS)
        self.layers: dict = {name: [] for name in names}
        self.layers |= {"version": "1.3", "canvas_edge": [3000.0, 3000.0], "arcline_path_3": {}, "connectivity": {}}

    def add_drivable_area(self, *polygons) -> None:
        """Add a drivable area of several polygons. Each is a list of rings of points: the exterior and the holes."""
        tokens = []
        for exterior, *holes in polygons:
            tokens.append(f"polygon {len(self.layers['polygon'])}")
            holes = [{"node_tokens": self._nodes(hole)} for hole in holes]
            record = {"token": tokens[-1], "exterior_node_tokens": self._nodes(exterior), "holes": holes}
            self.layers["polygon"].append(record)
        self.layers["drivable_area"].append({"token": f"area {len(tokens)}", "polygon_tokens": tokens})

    def add_divider(self, layer: str, points) -> None:
        """Add a line to road_divider or lane_divider."""
        token = f"line {len(self.layers['line'])}"
        self.layers["line"].append({"token": token, "node_tokens": self._nodes(points)})
        extra = {"lane_divider_segments": []} if layer == "lane_divider" else {"road_segment_token": None}
        self.layers[layer].append({"token": f"{layer} {len(self.layers[layer])}", "line_token": token, **extra})

    def write(self, root: Path, location: str = "boston-seaport") -> Path:
        """Write the file into a root, and return its path."""
        path = root / "maps" / "expansion" / f"{location}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(self.layers))
        return path

    def _nodes(self, points) -> list[str]:
        first = len(self.layers["node"])
        nodes = [
            {"token": f"node {first + i}", "x": x, "y": y}
            for i, (x, y) in enumerate(np.asarray(points, float).tolist())
        ]
        self.layers["node"] += nodes
        return [node["token"] for node in nodes]


def rectangle(x0, y0, x1, y1):
    """The corners of a rectangle."""
    return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
