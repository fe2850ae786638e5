import os
import socket
from pathlib import Path

import pytest

from duospacenet.runtime import files
from duospacenet.runtime.errors import InputError, OutputError
from duospacenet.runtime.files import (
    atomic_folder,
    check_regular_file,
    path_for_native_code,
    read_regular_file,
    write_atomically,
)


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


# --- Reading ------------------------------------------------------------------------------------------------------


def special_file(folder, kind):
    """Make a file of a kind that cannot be read as data, and return its path."""
    path = folder / "special"
    if kind == "FIFO":
        os.mkfifo(path)
    elif kind == "link to a FIFO":
        os.mkfifo(folder / "fifo")
        path.symlink_to(folder / "fifo")
    elif kind == "socket":
        with socket.socket(socket.AF_UNIX) as server:
            server.bind(str(path))
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "sparse file":
        with path.open("wb") as file:
            file.truncate(60 * 10**9)
    return path


SPECIAL_FILES = {
    "FIFO": r"expected a regular file; got a named pipe \(FIFO\)",
    "link to a FIFO": r"expected a regular file; got a named pipe \(FIFO\)",
    "socket": "expected a regular file; got a socket",
    "folder": "expected a regular file; got a folder",
    "device": "expected a regular file; got a device",
    "sparse file": "expected a file of at most 1000 bytes; got 60000000000",
    "missing": "expected a file; got no such file",
}


def test_a_folder_is_replaced_only_on_request_and_as_a_whole(tmp_path):
    path = tmp_path / "out"
    path.mkdir()
    (path / "old").touch()
    with pytest.raises(OutputError, match="cannot be written"), atomic_folder(path) as folder:
        (folder / "new").touch()
    assert [each.name for each in path.iterdir()] == ["old"]
    with atomic_folder(path, replace=True) as folder:
        (folder / "new").touch()
        assert [each.name for each in path.iterdir()] == ["old"]
    assert [each.name for each in path.iterdir()] == ["new"]
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("error", [OSError, KeyboardInterrupt])
def test_a_folder_that_cannot_be_replaced_is_kept(tmp_path, monkeypatch, error):
    path = tmp_path / "out"
    path.mkdir()
    (path / "old").touch()
    rename = Path.rename

    def fail_for_the_new_folder(self, target):
        if (self / "new").exists():
            raise error
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", fail_for_the_new_folder)
    expected = OutputError if error is OSError else error
    with pytest.raises(expected), atomic_folder(path, replace=True) as folder:
        (folder / "new").touch()
    assert [each.name for each in path.iterdir()] == ["old"]
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("kind", SPECIAL_FILES)
def test_a_special_file_is_refused_without_opening_it(tmp_path, monkeypatch, kind):
    path = special_file(tmp_path, kind)
    monkeypatch.setattr(os, "open", lambda *_: pytest.fail("the file was opened"))
    for read in (read_regular_file, check_regular_file):
        with pytest.raises(InputError, match=rf"special: {SPECIAL_FILES[kind]}"):
            read(path, 1000, InputError)


@pytest.mark.parametrize("kind", ["FIFO", "device", "sparse file"])
def test_a_file_that_is_replaced_after_the_check_is_refused_without_waiting_or_reading(tmp_path, monkeypatch, kind):
    path = special_file(tmp_path, kind)
    monkeypatch.setattr(files, "check_regular_file", lambda *_: 3)
    with pytest.raises(InputError, match=rf"special: {SPECIAL_FILES[kind]}"):
        read_regular_file(path, 1000, InputError)


def test_a_file_of_exactly_the_largest_size_is_read_and_a_larger_one_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"abc")
    assert read_regular_file(tmp_path / "file", 3, InputError) == b"abc"
    assert check_regular_file(tmp_path / "file", 3, InputError) == 3
    with pytest.raises(InputError, match="file: expected a file of at most 2 bytes; got 3"):
        read_regular_file(tmp_path / "file", 2, InputError)


def test_a_file_that_is_longer_than_its_size_says_is_refused():
    """Files below /proc have size 0 and content."""
    with pytest.raises(InputError, match="status: expected a file of 0 bytes; its size changed"):
        read_regular_file(Path("/proc/self/status"), 10**6, InputError)


def test_a_file_name_with_a_nul_byte_is_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_regular_file(tmp_path / "a\0b", 10, InputError)


def test_an_unreadable_file_is_refused_with_the_reason(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(InputError, match=r"loop: cannot be read \(Too many levels of symbolic links\)"):
        read_regular_file(tmp_path / "loop", 10, InputError)


def test_a_file_that_disappears_after_the_check_is_refused_with_its_path(tmp_path, monkeypatch):
    monkeypatch.setattr(files, "check_regular_file", lambda *_: 3)
    with pytest.raises(InputError, match=r"gone: expected a file; got no such file"):
        read_regular_file(tmp_path / "gone", 1000, InputError)


def test_the_start_of_a_long_file_is_its_first_64_kib(tmp_path):
    content = bytes(range(256)) * 257
    (tmp_path / "file").write_bytes(content)
    assert read_regular_file(tmp_path / "file", len(content), InputError, start_only=True) == content[:65536]
    (tmp_path / "short").write_bytes(b"abc")
    assert read_regular_file(tmp_path / "short", 3, InputError, start_only=True) == b"abc"


def test_a_path_for_native_code_is_a_descriptor_that_is_closed_again(tmp_path):
    """A name that the locale cannot decode. Python keeps its bytes as lone surrogates."""
    (tmp_path / "plain").write_bytes(b"abc")
    with path_for_native_code(tmp_path / "plain") as name:
        assert name == str(tmp_path / "plain")
    path = tmp_path / "b\udcff"
    path.write_bytes(b"abc")
    with path_for_native_code(path) as name:
        assert Path(name).read_bytes() == b"abc"
    assert not os.path.lexists(name)
