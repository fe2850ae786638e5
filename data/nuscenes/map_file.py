"""Reads `maps/expansion/LOCATION.json`, the map of one location in nuScenes' map expansion of version 1.3 or later."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TypeVar

import msgspec
import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from ...runtime.errors import InputError
from ...runtime.files import read_regular_file
from ...runtime.printable import printable, shortened
from .map_geometry import MapGeometry, Paths
from .table import PARSER_ERRORS

LEAST_VERSION = (1, 3)
MAX_MAP_BYTES = 2 * 10**9
MAX_COORDINATE_M = 1e6
DOWNLOAD = (
    "Download the map expansion pack v1.3 from https://www.nuscenes.org/download and unpack it into the folder maps of "
    "the root."
)

Record = TypeVar("Record")


class NodeRecord(Struct, frozen=True, gc=False):
    token: str
    x: float
    y: float


class HoleRecord(Struct, frozen=True, gc=False):
    node_tokens: list[str]


class PolygonRecord(Struct, frozen=True, gc=False):
    token: str
    exterior_node_tokens: list[str]
    holes: list[HoleRecord] = []


class LineRecord(Struct, frozen=True, gc=False):
    token: str
    node_tokens: list[str]


class DrivableAreaRecord(Struct, frozen=True, gc=False):
    token: str
    polygon_tokens: list[str]


class DividerRecord(Struct, frozen=True, gc=False):
    token: str
    line_token: str


class VersionRecord(Struct, frozen=True):
    """version: missing before version 1.1."""

    version: str | float = "1.0"


class MapRecord(Struct, frozen=True):
    """The layers that are read; the others are skipped."""

    node: list[NodeRecord]
    polygon: list[PolygonRecord]
    line: list[LineRecord]
    drivable_area: list[DrivableAreaRecord]
    road_divider: list[DividerRecord]
    lane_divider: list[DividerRecord]


def read_map(path: Path) -> MapGeometry:
    """Read the drivable area and the dividers of a location.

    Lines without nodes, and polygons with fewer than three, are left out. The published maps have some.

    Raises InputError, naming the file, if it is missing, damaged or of an older version. The message also names
    the record if a token leads to no record, or a coordinate is beyond 1,000 km.
    """
    if _is_missing(path):
        raise InputError(
            f"{path}: expected the map of this location; got no such file. {DOWNLOAD} "
            "Or remove the folder maps/expansion; a root without it has no map masks."
        )
    content = read_regular_file(path, MAX_MAP_BYTES, InputError)
    _check_version(path, content)
    return _Layers(path, _decode(path, content, MapRecord)).geometry()


class _Layers:
    """Follows the tokens of one file."""

    def __init__(self, path: Path, record: MapRecord) -> None:
        self._path = path
        self._record = record
        self._points = np.array([(node.x, node.y) for node in record.node], np.float64).reshape(-1, 2)
        self._nodes = {node.token: number for number, node in enumerate(record.node)}
        far = np.flatnonzero((np.abs(self._points) > MAX_COORDINATE_M).any(axis=1))
        if len(far):
            message = f"expected x and y of at most {MAX_COORDINATE_M:.0f} m; got {self._points[far[0]].tolist()}"
            raise self._error("node", int(far[0]), record.node[far[0]].token, message)

    def geometry(self) -> MapGeometry:
        rings, polygons = [], []
        for number, polygon in enumerate(self._drivable_polygons()):
            for ring in polygon:
                rings.append(ring)
                polygons.append(number)
        return MapGeometry(_join(rings), np.array(polygons, np.int64), _join(list(self._dividers())))

    def _drivable_polygons(self) -> Iterator[list[NDArray[np.float64]]]:
        """Yield the rings of each polygon of the drivable area, the exterior first."""
        numbers = {polygon.token: number for number, polygon in enumerate(self._record.polygon)}
        for row, area in enumerate(self._record.drivable_area):
            for token in area.polygon_tokens:
                number = self._find("drivable_area", row, area.token, "polygon", token, numbers)
                polygon = self._record.polygon[number]
                rings = [polygon.exterior_node_tokens, *(hole.node_tokens for hole in polygon.holes)]
                points = [self._follow("polygon", number, polygon.token, ring) for ring in rings]
                if len(points[0]) >= 3:
                    yield [ring for ring in points if len(ring) >= 3]

    def _dividers(self) -> Iterator[NDArray[np.float64]]:
        """Yield the points of each road divider and lane divider."""
        numbers = {line.token: number for number, line in enumerate(self._record.line)}
        for layer in ("road_divider", "lane_divider"):
            for row, divider in enumerate(getattr(self._record, layer)):
                number = self._find(layer, row, divider.token, "line", divider.line_token, numbers)
                line = self._record.line[number]
                points = self._follow("line", number, line.token, line.node_tokens)
                if len(points):
                    yield points

    def _follow(self, layer: str, row: int, token: str, node_tokens: Sequence[str]) -> NDArray[np.float64]:
        """Return the points of nodes. layer, row, token: of the record that names them."""
        return self._points[[self._find(layer, row, token, "node", node, self._nodes) for node in node_tokens]]

    def _find(self, layer: str, row: int, token: str, target: str, target_token: str, numbers: dict[str, int]) -> int:
        """Return the row that a token names in the layer `target`, which has the rows `numbers` by token."""
        number = numbers.get(target_token)
        if number is None:
            message = f"expected a token of the layer {target}; got {shortened(target_token)}, which it does not have"
            raise self._error(layer, row, token, message)
        return number

    def _error(self, layer: str, row: int, token: str, message: str) -> InputError:
        return InputError(f"{self._path}: layer {layer}, row {row}, token {shortened(token)}: {message}.")


def _is_missing(path: Path) -> bool:
    try:
        path.stat()
    except FileNotFoundError:
        return True
    except OSError:  # the file exists, and reading it gives the error message
        return False
    return False


def _check_version(path: Path, content: bytes) -> None:
    """Raise InputError for an older version. Its records differ, so the version is checked before them."""
    version = str(_decode(path, content, VersionRecord).version)
    parts = version.split(".")
    if not all(part.isascii() and part.isdigit() and len(part) < 6 for part in parts):
        raise InputError(f"{path}: expected a version such as 1.3; got {shortened(version)}. {DOWNLOAD}")
    if tuple(map(int, parts)) < LEAST_VERSION:
        raise InputError(f"{path}: expected a map of version 1.3 or later; got version {version}. {DOWNLOAD}")


def _decode(path: Path, content: bytes, record_type: type[Record]) -> Record:
    try:
        return msgspec.json.decode(content, type=record_type)
    except PARSER_ERRORS as error:
        raise InputError(
            f"{path}: expected the layers of a map expansion; got something else ({printable(str(error))}). {DOWNLOAD}"
        ) from None


def _join(paths: list[NDArray[np.float64]]) -> Paths:
    points = np.concatenate(paths) if paths else np.zeros((0, 2))
    return Paths(points, np.cumsum([len(path) for path in paths], dtype=np.int64))
