"""When the index of a root is built, and when the one in the cache folder is used."""

import multiprocessing
import os
import pickle
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from duospacenet.data.nuscenes import index_file
from duospacenet.data.nuscenes.index_file import index_path
from duospacenet.data.nuscenes.nuscenes_source import NuscenesSource
from duospacenet.runtime.errors import InputError, OutputError
from tests.helpers.nuscenes_tables import VERSION, row, tiny_tables, write_tables


@pytest.fixture
def root(tmp_path):
    return write_tables(tmp_path / "root", tiny_tables())


@pytest.fixture
def builds(monkeypatch):
    """The version folders of the indices that were built."""
    folders = []
    build = index_file.build_index

    def build_and_count(folder, progress):
        folders.append(folder)
        return build(folder, progress)

    monkeypatch.setattr(index_file, "build_index", build_and_count)
    return folders


def test_the_index_is_built_once(root, builds, cache_folder):
    first, second = NuscenesSource(str(root)), NuscenesSource(f"{root}@{VERSION}/scene-0061")
    assert builds == [root / VERSION]
    assert [path.suffix for path in (cache_folder / "nuscenes").iterdir()] == [".npz"]
    assert second.frame_without_images(0).token == first.frame_without_images(0).token == "a0"


def test_a_changed_table_rebuilds_the_index(root, builds):
    NuscenesSource(str(root))
    tables = tiny_tables()
    row(tables, "sample_annotation", "bus0")["num_radar_pts"] = 3  # a file of the same size
    write_tables(root, tables)
    assert NuscenesSource(str(root)).ground_truth_without_maps(1).num_points[0] == 10
    table = root / VERSION / "map.json"
    table.write_text("[]")  # is not read
    NuscenesSource(str(root))
    assert len(builds) == 2


def test_a_table_that_is_removed_later_is_missed(root):
    NuscenesSource(str(root))
    (root / VERSION / "visibility.json").unlink()
    with pytest.raises(InputError, match=r"visibility\.json: expected the nuScenes table"):
        NuscenesSource(str(root))


def damage(data, where):
    position = int(where * (len(data) - 1))
    return data[:position] + bytes([data[position] ^ 0xFF]) + data[position + 1 :]


@pytest.mark.parametrize(
    "change",
    [
        lambda data: b"",
        lambda data: data[: len(data) // 2],
        lambda data: data[:-1],
        lambda data: b"not an index",
        *(lambda data, where=where: damage(data, where) for where in (0.1, 0.3, 0.5, 0.7, 0.9)),
    ],
)
def test_a_damaged_index_is_rebuilt(root, builds, change):
    NuscenesSource(str(root))
    path = index_path(root / VERSION)
    path.write_bytes(change(path.read_bytes()))
    assert list(NuscenesSource(str(root)).tokens) == ["a0", "b0", "b1", "b2"]
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None


def test_an_index_in_a_file_of_another_kind_is_rebuilt(root, builds):
    NuscenesSource(str(root))
    path = index_path(root / VERSION)
    path.unlink()
    os.mkfifo(path)  # opening it would wait for a writer
    NuscenesSource(str(root))
    path.unlink()
    path.symlink_to(path)
    NuscenesSource(str(root))
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    NuscenesSource(str(root))
    assert len(builds) == 4


@pytest.mark.parametrize("name", ["tokens", "1/frames", "1/images", "1/file_names", "1/calibrations", "1/boxes"])
def test_an_array_of_another_type_in_an_index_is_an_error(root, name):
    NuscenesSource(str(root))
    path = index_path(root / VERSION)
    with np.load(path) as arrays:
        changed = dict(arrays) | {name: np.zeros(3, [("x", np.float64)])}
    np.savez(path, **changed)
    with pytest.raises(InputError, match=rf"expected an undamaged index .* damage in {name}"):
        NuscenesSource(str(root)).frame_without_images(1)


def test_an_index_of_another_format_is_rebuilt(root, builds, monkeypatch):
    NuscenesSource(str(root))
    monkeypatch.setattr("duospacenet.data.nuscenes.index_builder.INDEX_FORMAT", 999)
    monkeypatch.setattr(index_file, "INDEX_FORMAT", 999)
    NuscenesSource(str(root))
    NuscenesSource(str(root))
    assert len(builds) == 2


def test_an_index_that_is_damaged_while_it_is_used_is_an_error(root):
    source = pickle.loads(pickle.dumps(NuscenesSource(str(root))))
    path = index_path(root / VERSION)
    with zipfile.ZipFile(path) as archive:
        member = archive.getinfo("1/frames.npy")
    data = bytearray(path.read_bytes())
    data[member.header_offset + 200] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(InputError, match=r"\.npz: expected an undamaged index .* damage in 1/frames"):
        source.frame_without_images(1)


def test_an_index_has_no_pickled_objects(root):
    NuscenesSource(str(root))
    with np.load(index_path(root / VERSION), allow_pickle=False) as arrays:
        assert all(not arrays[name].dtype.hasobject for name in arrays.files)


def test_each_version_and_each_root_has_an_index_of_its_own(root, tmp_path, builds):
    write_tables(root, tiny_tables(), "v1.0-test")
    other = write_tables(tmp_path / "other", tiny_tables())
    (tmp_path / "link").symlink_to(other)
    for name in (f"{root}@{VERSION}", f"{root}@v1.0-test", other, tmp_path / "link"):
        NuscenesSource(str(name))
    assert len(builds) == 3


def test_a_cache_folder_that_cannot_be_written_is_an_error_that_names_the_variable(root, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DUOSPACENET_CACHE", str(tmp_path / "file"))
    with pytest.raises(OutputError, match=r"cannot write .*\.npz.*Set DUOSPACENET_CACHE to a writable folder"):
        NuscenesSource(str(root))


def test_nothing_remains_of_an_index_that_could_not_be_written(root, monkeypatch, cache_folder):
    def fail(path, **arrays):
        Path(path).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(OutputError, match="No space left on device"):
        NuscenesSource(str(root))
    assert list((cache_folder / "nuscenes").iterdir()) == []


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({"DUOSPACENET_CACHE": "/c/mine", "XDG_CACHE_HOME": "/x"}, "/c/mine/nuscenes"),
        ({"XDG_CACHE_HOME": "/x"}, "/x/duospacenet/nuscenes"),
        ({"XDG_CACHE_HOME": "relative", "HOME": "/home/me"}, "/home/me/.cache/duospacenet/nuscenes"),
        ({"HOME": "/home/me"}, "/home/me/.cache/duospacenet/nuscenes"),
    ],
)
def test_the_cache_folder_follows_the_environment(monkeypatch, variables, expected):
    for name in ("DUOSPACENET_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    path = index_path(Path("/data/nuscenes/v1.0-mini"))
    assert str(path.parent) == expected
    assert path.name.startswith("v1.0-mini-")


def open_and_count(root):
    return len(list(NuscenesSource(str(root)).tokens))


def test_two_processes_may_build_the_same_index(root):
    with multiprocessing.get_context("spawn").Pool(2) as pool:
        assert pool.map(open_and_count, [str(root)] * 4) == [4] * 4
    assert len(list(index_path(root / VERSION).parent.iterdir())) == 1


def test_building_shows_its_progress_in_percent(tmp_path):
    tables = tiny_tables()
    tables["ego_pose"] += [{**tables["ego_pose"][0], "token": f"other {number}"} for number in range(1000)]
    root = write_tables(tmp_path, tables)
    steps = []

    def progress(items, description):
        for item in items:
            steps.append(description)
            yield item

    for _ in range(2):
        NuscenesSource(str(root), progress=progress)
    # Tables of 20, 1016 and 4 rows.
    assert Counter(steps) == {"index sample_data": 20, "index ego_pose": 102, "index sample_annotation": 4}
