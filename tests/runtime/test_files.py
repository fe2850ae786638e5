import pytest

from duospacenet.runtime.errors import OutputError
from duospacenet.runtime.files import write_atomically


def test_a_file_is_replaced_by_the_whole_new_one(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old and long")
    write_atomically(path, b"new")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_place_that_is_a_folder_is_refused_and_kept(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(OutputError, match="Is a directory"):
        write_atomically(tmp_path / "a", b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_missing_folder_is_refused_and_not_made(tmp_path):
    with pytest.raises(OutputError, match="No such file or directory"):
        write_atomically(tmp_path / "missing" / "a", b"new")
    assert list(tmp_path.iterdir()) == []
