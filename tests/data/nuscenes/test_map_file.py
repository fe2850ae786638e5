"""Map expansion files: which geometry is read from them, and which files are refused."""

import numpy as np
import pytest

from duospacenet.data.nuscenes.map_file import read_map
from duospacenet.runtime.errors import InputError
from tests.helpers.map_files import MapFile, rectangle


@pytest.fixture
def file():
    """A file with two polygons, one of them with a hole, and a line of each kind."""
    file = MapFile()
    file.add_drivable_area([rectangle(0, 0, 10, 10), rectangle(2, 2, 4, 4)], [rectangle(20, 0, 30, 10)])
    file.add_divider("road_divider", [(0, 5), (10, 5)])
    file.add_divider("lane_divider", [(0, 7), (5, 8), (10, 7)])
    return file


def test_polygons_holes_and_dividers_are_read(file, tmp_path):
    geometry = read_map(file.write(tmp_path))
    polygons = geometry.rings_near(np.array([-100.0, -100]), np.array([100.0, 100]))
    assert [[ring.tolist() for ring in rings] for rings in polygons] == [
        [[list(p) for p in rectangle(0, 0, 10, 10)], [list(p) for p in rectangle(2, 2, 4, 4)]],
        [[list(p) for p in rectangle(20, 0, 30, 10)]],
    ]
    lines = geometry.lines_near(np.array([-100.0, -100]), np.array([100.0, 100]))
    assert [line.tolist() for line in lines] == [[[0, 5], [10, 5]], [[0, 7], [5, 8], [10, 7]]]


def test_only_geometry_near_a_rectangle_is_given(file, tmp_path):
    geometry = read_map(file.write(tmp_path))
    near = geometry.rings_near(np.array([5.0, 5.0]), np.array([8.0, 8.0]))
    assert [len(rings) for rings in near] == [1]  # the hole and the second polygon are elsewhere
    assert len(geometry.rings_near(np.array([11.0, 0.0]), np.array([19.0, 9.0]))) == 0
    assert [line[0, 1] for line in geometry.lines_near(np.array([1.0, 6.0]), np.array([2.0, 9.0]))] == [7]


def test_polygons_and_lines_without_points_are_left_out(file, tmp_path):
    file.add_divider("lane_divider", [])
    file.add_drivable_area([[]], [[(0, 0), (1, 1)]], [rectangle(40, 40, 50, 50), []])
    geometry = read_map(file.write(tmp_path))
    assert len(geometry.lines.ends) == 2
    assert geometry.polygons.tolist() == [0, 0, 1, 2]


def test_a_map_without_geometry_is_read(tmp_path):
    geometry = read_map(MapFile().write(tmp_path))
    assert geometry.rings_near(np.zeros(2), np.ones(2)) == geometry.lines_near(np.zeros(2), np.ones(2)) == []


@pytest.mark.parametrize("version", ["1.3", "1.4", "1.10", "2.0", 1.3])
def test_later_versions_are_read(file, tmp_path, version):
    file.layers["version"] = version
    assert len(read_map(file.write(tmp_path)).lines.ends) == 2


@pytest.mark.parametrize(
    ("version", "message"),
    [
        ("1.2", "expected a map of version 1.3 or later; got version 1.2. Download the map expansion pack v1.3"),
        ("1.0", "got version 1.0"),
        (None, "got version 1.0"),
        ("0.9.10", "got version 0.9.10"),
        ("one\x1b", r"expected a version such as 1.3; got 'one\x1b'"),
        ("-1.5", "expected a version such as 1.3"),
        ("", "expected a version such as 1.3"),
        ([1, 3], "expected the layers of a map expansion"),
    ],
)
def test_older_versions_and_other_texts_are_refused_with_what_to_download(file, tmp_path, version, message):
    file.layers["version"] = version
    if version is None:
        del file.layers["version"]
    path = file.write(tmp_path)
    with pytest.raises(InputError) as error:
        read_map(path)
    assert message in str(error.value) and str(path) in str(error.value)


def set_node(file, **fields):
    file.layers["node"][3] |= fields


DAMAGES = {
    "a token of a node": (
        lambda file: file.layers["polygon"][0]["holes"][0]["node_tokens"].append("x\x1b"),
        r"layer polygon, row 0, token 'polygon 0': expected a token of the layer node; got 'x\x1b', which it does not",
    ),
    "a token of a polygon": (
        lambda file: file.layers["drivable_area"][0]["polygon_tokens"].append("lost"),
        "layer drivable_area, row 0, token 'area 2': expected a token of the layer polygon; got 'lost'",
    ),
    "a token of a line": (
        lambda file: file.layers["lane_divider"][0].update(line_token="lost"),
        "layer lane_divider, row 0, token 'lane_divider 0': expected a token of the layer line; got 'lost'",
    ),
    "a node that is not on Earth": (lambda file: set_node(file, x=-1e9), "layer node, row 3, token 'node 3'"),
    "a node without a number": (lambda file: set_node(file, x="far"), "Expected `float`, got `str`"),
    "a layer": (lambda file: file.layers.pop("line"), "missing required field `line`"),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damaged_file_is_refused_with_the_record(file, tmp_path, name):
    damage, message = DAMAGES[name]
    damage(file)
    path = file.write(tmp_path)
    with pytest.raises(InputError) as error:
        read_map(path)
    assert message in str(error.value) and str(path) in str(error.value)
    assert "\x1b" not in str(error.value)


@pytest.mark.parametrize(
    "content", [b"", b'{"version": "1.3", "node": [', b"[]", b"\xff\xfe", b'{"version": "1.3", "node": [NaN]}']
)
def test_a_file_that_is_no_map_is_refused(tmp_path, content):
    path = tmp_path / "boston-seaport.json"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"boston-seaport.json: expected the layers of a map expansion; got something"):
        read_map(path)


def test_a_file_that_is_nested_too_deeply_is_refused(tmp_path):
    path = tmp_path / "boston-seaport.json"
    path.write_text('{"extra": ' + "[" * 100_000 + "]" * 100_000 + ', "version": "1.3"}')
    with pytest.raises(InputError, match="expected the layers of a map expansion"):
        read_map(path)


def test_a_folder_in_the_place_of_a_map_is_refused(tmp_path):
    with pytest.raises(InputError, match="expected a regular file; got a folder"):
        read_map(tmp_path)


def test_a_missing_file_is_refused_with_what_to_download(tmp_path):
    with pytest.raises(InputError, match=r"queenstown.json: expected the map of this location.*pack v1\.3"):
        read_map(tmp_path / "singapore-queenstown.json")
