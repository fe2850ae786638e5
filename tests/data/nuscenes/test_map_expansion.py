"""Masks of a frame, from the maps of a root."""

import json
import pickle
import shutil

import numpy as np
import pytest

from duospacenet.data.mask_grid import MaskGrid
from duospacenet.data.nuscenes import map_expansion
from duospacenet.data.nuscenes.map_expansion import MapExpansion
from duospacenet.data.nuscenes.nuscenes_source import NuscenesSource
from duospacenet.runtime.errors import InputError, OutputError
from duospacenet.runtime.geometry import rigid_transform, rotation_z
from duospacenet.synthetic.drive import outlines_to_ego
from duospacenet.synthetic.map_masks import cells_with_centre_inside
from duospacenet.synthetic.nuscenes_root.map_layout import MapLayout
from duospacenet.synthetic.road import Road
from tests.helpers.map_files import MapFile, rectangle
from tests.helpers.nuscenes_roots import write_small_root

BOSTON = "boston-seaport"
GRID = MaskGrid((200, 200))


@pytest.fixture(scope="module")
def synthetic_root(tmp_path_factory):
    return write_small_root(tmp_path_factory.mktemp("roots") / "root", 2, 2, seed=3)


@pytest.fixture
def root(tmp_path):
    """A road along the global y axis with an island, a median line and a line at its right edge."""
    file = MapFile()
    file.add_drivable_area([rectangle(490, 0, 510, 2000), rectangle(498, 1020, 502, 1030)])
    file.add_divider("road_divider", [(500, 0), (500, 2000)])
    file.add_divider("lane_divider", [(508, 0), (508, 2000)])
    file.write(tmp_path)
    return tmp_path


def cells_of(x_m, y_m):
    """The cell of a place in the ego frame on 200 x 200 cells."""
    return int((x_m + 51.2) / 0.512), int((y_m + 51.2) / 0.512)


def test_masks_are_in_the_ego_frame_of_the_vehicle(root):
    """The vehicle drives along global +y, which is forward; global +x is on its right."""
    global_T_ego = rigid_transform(rotation_z(np.pi / 2), [504.0, 1000.0, 0.0])
    masks = MapExpansion(root, [BOSTON]).masks(BOSTON, global_T_ego, GRID)
    drivable, boundary = masks["drivable_area"], masks["lane_boundary"]
    assert drivable.shape == boundary.shape == (200, 200)
    for x, y, on_road in [(0, 0, 1), (40, 0, 1), (-40, 0, 1), (0, 13, 1), (0, 15, 0), (0, -5, 1), (0, -7, 0)]:
        assert drivable[cells_of(x, y)] == on_road, (x, y)
    for x, y, is_road in [
        (25, 4, 0),
        (25, 1, 1),
        (18, 4, 1),
        (32, 4, 1),
        (-25, 4, 1),
    ]:  # the island is 20 to 30 m ahead
        assert drivable[cells_of(x, y)] == is_road, (x, y)
    columns = np.flatnonzero(boundary.all(axis=0))
    np.testing.assert_allclose((columns + 0.5) * 0.512 - 51.2, [-4.5, -4.0, -3.5, 3.5, 4.0, 4.5], atol=0.4)
    assert boundary.sum() == boundary.all(axis=0).sum() * 200


def test_a_tilted_ego_and_one_above_the_ground_have_the_same_masks(root):
    maps = MapExpansion(root, [BOSTON])
    level = rigid_transform(rotation_z(0.3), [504.0, 1000.0, 0.0])
    tilt = np.array([[np.cos(0.01), 0, np.sin(0.01)], [0, 1, 0], [-np.sin(0.01), 0, np.cos(0.01)]])
    tilted = rigid_transform(rotation_z(0.3) @ tilt, [504.0, 1000.0, 120.0])
    expected, actual = maps.masks(BOSTON, level, GRID), maps.masks(BOSTON, tilted, GRID)
    assert (expected["drivable_area"] != actual["drivable_area"]).mean() < 0.002
    assert (expected["lane_boundary"] != actual["lane_boundary"]).mean() < 0.002


@pytest.mark.parametrize("size", [(200, 200), (64, 64)])
def test_the_drivable_area_of_a_synthetic_root_is_that_of_its_streets(synthetic_root, size):
    """The streets of the world, rasterised by the code that makes the masks of `synthetic:SEED`."""
    source = NuscenesSource(f"{synthetic_root}/scene-0061", grid=MaskGrid(size))
    frame = source.frame(1)
    layout = MapLayout()
    place = layout.place(0, 3, 2)
    patches = [
        patch.outline for patch in Road(3, place.ends_m[1] - 120).ground_patches(-74, 90) if patch.kind == "asphalt"
    ]
    ego_T_global = np.linalg.inv(frame.global_T_ego)
    outlines = outlines_to_ego(ego_T_global, [outline + place.origin_m for outline in patches])
    expected = cells_with_centre_inside(outlines, size)
    assert expected.mean() > 0.1
    assert (frame.ground_truth.maps["drivable_area"] != expected).mean() < 0.01


def test_the_lane_boundaries_of_a_synthetic_root_are_painted_lines_without_kerbs(synthetic_root):
    masks = NuscenesSource(f"{synthetic_root}/scene-0061", grid=MaskGrid((200, 200))).frame(0).ground_truth.maps
    boundary, drivable = masks["lane_boundary"], masks["drivable_area"]
    assert 0.02 < boundary.mean() < 0.2
    assert drivable[boundary].mean() > 0.99  # kerbs would be half outside


def test_a_source_without_a_grid_and_a_root_without_maps_have_none(synthetic_root, tmp_path):
    source = NuscenesSource(str(synthetic_root))
    assert not source.has_maps(0) and source.frame(0).ground_truth.maps == {}
    assert source.map_names(0) == set()
    shutil.copytree(synthetic_root, tmp_path / "root", ignore=lambda *_: ["expansion"])
    source = NuscenesSource(str(tmp_path / "root"), grid=MaskGrid((200, 200)))
    assert not source.has_maps(0) and source.frame(0).ground_truth.maps == {}


def test_a_version_without_annotations_has_maps(tmp_path):
    source = NuscenesSource(str(write_small_root(tmp_path / "root", 1, 1, split="test")), grid=MaskGrid((64, 64)))
    truth = source.frame(0).ground_truth
    assert source.has_maps(0) and not source.has_boxes(0)
    assert not truth.has_boxes and truth.maps["drivable_area"].any()
    assert source.map_names(0) == truth.maps.keys()


@pytest.mark.parametrize("location", ["../../secret", "a/b", ".hidden", "", "boston\x1b"])
def test_a_location_that_is_no_file_name_is_refused(tmp_path, location):
    with pytest.raises(InputError, match="expected locations of the table log with letters"):
        MapExpansion(tmp_path, [location])


def test_maps_of_the_chosen_scenes_alone_are_needed(synthetic_root, tmp_path):
    root = shutil.copytree(synthetic_root, tmp_path / "root")
    (root / "maps" / "expansion" / "singapore-hollandvillage.json").unlink()
    train = NuscenesSource(f"{root}/mini_train", grid=MaskGrid((64, 64)))
    assert train.frame(0).ground_truth.maps["drivable_area"].any()
    with pytest.raises(InputError, match=r"singapore-hollandvillage.json: expected the map of this location"):
        NuscenesSource(f"{root}/mini_val", grid=MaskGrid((64, 64)))


def test_maps_of_an_older_version_in_their_older_place_are_refused(synthetic_root, tmp_path):
    root = shutil.copytree(synthetic_root, tmp_path / "root")
    for path in (root / "maps" / "expansion").iterdir():
        (root / "maps" / path.name).write_text(path.read_text().replace('"version": "1.3"', '"version": "1.2"'))
    shutil.rmtree(root / "maps" / "expansion")
    with pytest.raises(InputError, match=r"maps/boston-seaport.json: .* 1.3 or later; got version 1.2. Download"):
        NuscenesSource(str(root), grid=MaskGrid((64, 64)))
    assert NuscenesSource(str(root)).frame(0).ground_truth.maps == {}


def test_another_process_gets_a_small_source_with_the_same_masks(synthetic_root):
    source = NuscenesSource(str(synthetic_root), grid=MaskGrid((64, 64)))
    pickled = pickle.dumps(source)
    assert len(pickled) < 10_000
    for name, mask in pickle.loads(pickled).frame(1).ground_truth.maps.items():
        np.testing.assert_array_equal(mask, source.frame(1).ground_truth.maps[name])


@pytest.fixture
def reads(monkeypatch):
    """The map files that are read, as opposed to the cache folder."""
    paths, read_map = [], map_expansion.read_map
    monkeypatch.setattr(map_expansion, "read_map", lambda path: paths.append(path.name) or read_map(path))
    return paths


def test_a_map_is_read_once_and_again_when_it_changes(root, reads):
    pose = rigid_transform(np.eye(3), [500.0, 1000.0, 0.0])
    first = MapExpansion(root, [BOSTON]).masks(BOSTON, pose, GRID)
    second = MapExpansion(root, [BOSTON]).masks(BOSTON, pose, GRID)
    assert reads == ["boston-seaport.json"]
    for name, mask in first.items():
        np.testing.assert_array_equal(mask, second[name])
    path = root / "maps" / "expansion" / "boston-seaport.json"
    layers = json.loads(path.read_text())
    layers["lane_divider"] = []
    path.write_text(json.dumps(layers))
    third = MapExpansion(root, [BOSTON]).masks(BOSTON, pose, GRID)
    assert len(reads) == 2 and third["lane_boundary"].sum() < first["lane_boundary"].sum()


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-100], lambda data: b"", lambda data: data[:500] + b"\0" * 50 + data[550:]]
)
def test_a_damaged_file_in_the_cache_folder_is_made_again(root, reads, cache_folder, damage):
    MapExpansion(root, [BOSTON])
    (cached,) = (cache_folder / "nuscenes").iterdir()
    cached.write_bytes(damage(cached.read_bytes()))
    masks = MapExpansion(root, [BOSTON]).masks(BOSTON, rigid_transform(np.eye(3), [500.0, 1000.0, 0.0]), GRID)
    assert len(reads) == 2 and masks["drivable_area"].any()


def test_a_map_folder_that_links_to_itself_is_an_input_error(root):
    folder = root / "maps" / "expansion"
    shutil.rmtree(folder)
    folder.symlink_to(folder)
    with pytest.raises(InputError, match=r"boston-seaport\.json: cannot be read \(Too many levels"):
        MapExpansion(root, [BOSTON])


def test_a_cache_folder_that_cannot_be_written_is_an_error(root, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DUOSPACENET_CACHE", str(tmp_path / "file"))
    with pytest.raises(OutputError, match="DUOSPACENET_CACHE"):
        MapExpansion(root, [BOSTON])
