import pytest

from duospacenet.runtime.errors import OutputError
from duospacenet.runtime.files import atomic_folder, write_atomically


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


def test_a_folder_appears_only_when_it_is_complete(tmp_path):
    folder = tmp_path / "new" / "a"
    with atomic_folder(folder) as staging_dir:
        (staging_dir / "file").write_text("content")
        assert not folder.exists()
    assert (folder / "file").read_text() == "content"
    assert list(folder.parent.iterdir()) == [folder]


@pytest.mark.parametrize(
    ("failure", "raised"),
    [(KeyboardInterrupt(), KeyboardInterrupt), (OSError(28, "No space left on device"), OutputError)],
)
def test_a_folder_is_absent_after_an_exception(tmp_path, failure, raised):
    with pytest.raises(raised), atomic_folder(tmp_path / "a") as staging_dir:
        (staging_dir / "file").write_text("content")
        raise failure
    assert list(tmp_path.iterdir()) == []
