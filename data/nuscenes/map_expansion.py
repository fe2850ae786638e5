"""The maps of a nuScenes root as masks of its frames, from the map expansion (version 1.3 or later).

`drivable_area` is the layer of this name. `lane_boundary` are the lines of the layers lane_divider and road_divider.

The paper follows PETRv2, which makes its masks of the same layers with nuscenes-devkit. They differ from these in five
points: they are centred on the lidar, 0.94 m ahead of the ego frame; the published code has 256 x 256 cells of 0.4 m,
where the paper says 200 x 200; positions are rounded to whole cells; vehicles are cut out of both masks; and lines are
cut out of the drivable area. Source: tools/data_converter/nuscenes_converter_seg.py of megvii-research/PETR.
"""

import os
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...runtime.errors import InputError
from ...runtime.files import change_stamp
from ...runtime.printable import shortened
from ...runtime.progress import Progress, no_progress
from ..mask_grid import MaskGrid
from .cache_folder import DAMAGE, cache_path, open_arrays, write_arrays
from .map_file import read_map
from .map_geometry import MapGeometry, Paths
from .map_rasterisation import Mask, draw_lines, fill_polygons

EXPANSION = Path("maps", "expansion")
OLDER_EXPANSION = Path("maps")  # of versions before 1.3
GEOMETRY_FORMAT = 1  # of the files in the cache folder; increased when their content changes

_LOCATION = re.compile(r"[A-Za-z0-9_.-]+")

MAP_NAMES = ("drivable_area", "lane_boundary")


class MapExpansion:
    """The maps of some locations. A copy in another process reads their geometry again, from the cache folder."""

    def __init__(self, root: Path, locations: Iterable[str], progress: Progress = no_progress) -> None:
        """Read the maps, or what the cache folder has of them.

        root: the folder with `maps/expansion`.
        progress: of the locations.

        Raises InputError, naming the file, for a map that is missing, damaged, or of an older version, and OutputError
        if the cache folder cannot be written.
        """
        self._paths = {location: _map_path(root, location) for location in sorted(set(locations))}
        self._geometries: dict[str, MapGeometry] = {}
        for location in progress(list(self._paths), "maps"):
            self._geometry(location)

    @staticmethod
    def is_installed(root: Path) -> bool:
        """Whether a root has maps at all. Maps of an older version count too; they give an error when they are read."""
        return os.path.lexists(root / EXPANSION) or any((root / OLDER_EXPANSION).glob("*.json"))

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_geometries": {}}

    def masks(self, location: str, global_T_ego: NDArray[np.float64], grid: MaskGrid) -> dict[str, Mask]:
        """The masks (X, Y) of a frame by map class.

        global_T_ego: (4, 4) of the frame. The map is taken as a plane through the ego, parallel to that of the global x
            and y.
        grid: cells of the masks, in the ego frame.
        """
        geometry = self._geometry(location)
        global_R_ego, position_m = global_T_ego[:2, :2], global_T_ego[:2, 3]
        corners = grid.corners @ global_R_ego.T + position_m
        margin = 2 * grid.cell_m.max()  # for the width of lines, and for the tilt of the ego
        lower, upper = corners.min(axis=0) - margin, corners.max(axis=0) + margin

        def to_ego(points: NDArray[np.float64]) -> NDArray[np.float64]:
            return (points - position_m) @ global_R_ego

        polygons = [[to_ego(ring) for ring in rings] for rings in geometry.rings_near(lower, upper)]
        lines = [to_ego(line) for line in geometry.lines_near(lower, upper)]
        return dict(zip(MAP_NAMES, (fill_polygons(polygons, grid), draw_lines(lines, grid)), strict=True))

    def _geometry(self, location: str) -> MapGeometry:
        if location not in self._geometries:
            self._geometries[location] = _open_geometry(self._paths[location])
        return self._geometries[location]


def _map_path(root: Path, location: str) -> Path:
    if not _LOCATION.fullmatch(location) or location.startswith("."):
        raise InputError(
            f"{root}: expected locations of the table log with letters, digits, '-', '_' and '.', as their maps are "
            f"files with these names; got {shortened(location)}. Rename it in the table log."
        )
    path, older = (root / folder / f"{location}.json" for folder in (EXPANSION, OLDER_EXPANSION))
    return older if os.path.lexists(older) and not os.path.lexists(path) else path


def _open_geometry(path: Path) -> MapGeometry:
    """Read the geometry of a map file from the cache folder, or from the file itself if that has changed."""
    cached = cache_path(path, f"map-{path.stem}")
    stamp = _stamp(path)
    try:
        with open_arrays(cached) as cache:
            if stamp is not None and cache["stamp"].tolist() == stamp:
                rings = Paths(cache["ring_points"], cache["ring_ends"])
                return MapGeometry(rings, cache["polygons"], Paths(cache["line_points"], cache["line_ends"]))
    except DAMAGE:
        pass
    geometry = read_map(path)
    arrays = {
        "ring_points": geometry.rings.points,
        "ring_ends": geometry.rings.ends,
        "polygons": geometry.polygons,
        "line_points": geometry.lines.points,
        "line_ends": geometry.lines.ends,
    }
    if stamp is not None:
        write_arrays(cached, arrays | {"stamp": np.array(stamp, np.int64)})
    return geometry


def _stamp(path: Path) -> list[int] | None:
    """What a cached file was built from: its format, and the stamp of the map file."""
    try:
        status = path.stat()
    except OSError:
        return None
    return [GEOMETRY_FORMAT, *change_stamp(status)]
