import pytest

from duospacenet.runtime.errors import OutputError
from duospacenet.runtime.files import write_atomically


def test_writing_replaces_an_existing_file_completely(tmp_path):
    path = tmp_path / "a.bin"
    path.write_bytes(b"old and long")
    write_atomically(path, b"new")
    assert path.read_bytes() == b"new"
    assert list(tmp_path.iterdir()) == [path]


def test_a_path_that_is_a_folder_is_refused_and_not_changed(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(OutputError, match="Is a directory"):
        write_atomically(tmp_path / "a", b"new")
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_missing_folder_is_refused_and_not_created(tmp_path):
    with pytest.raises(OutputError, match="No such file or directory"):
        write_atomically(tmp_path / "missing" / "a", b"new")
    assert list(tmp_path.iterdir()) == []
