"""A file whose failed writes are remembered."""

import os
from pathlib import Path

import pytest

from duospacenet.drawing.checked_file import CheckedFile
from duospacenet.runtime.errors import OutputError


def test_it_writes_and_seeks_as_a_file(tmp_path):
    file = CheckedFile(tmp_path / "file", tmp_path / "name")
    assert file.write(b"abcdef") == 6
    assert file.seek(2) == 2
    assert file.write(b"XY") == 2
    assert file.seek(0, os.SEEK_CUR) == 4
    assert file.seek(0, os.SEEK_END) == 6
    assert file.write(bytearray(b"!")) == 1
    file.check()
    file.close()
    assert (tmp_path / "file").read_bytes() == b"abXYef!"


def test_after_a_failed_write_positions_go_on_and_the_check_names_the_file(monkeypatch):
    full = Path("/dev/full").open("wb", buffering=0)  # noqa: SIM115
    monkeypatch.setattr(Path, "open", lambda *_, **__: full)
    file = CheckedFile(Path("drive"), Path("drive.mcap"))
    assert file.write(b"abc") == 3
    assert file.write(b"de") == 2
    assert file.seek(0, os.SEEK_CUR) == file.seek(0, os.SEEK_END) == 5
    with pytest.raises(OutputError, match=r"cannot write drive\.mcap: No space left on device"):
        file.check()
    file.close()


def test_an_existing_file_and_a_missing_folder_are_refused(tmp_path):
    (tmp_path / "file").write_bytes(b"mine")
    for path in (tmp_path / "file", tmp_path / "none" / "file"):
        with pytest.raises(OutputError, match=r"cannot write .*name"):
            CheckedFile(path, tmp_path / "name")
    assert (tmp_path / "file").read_bytes() == b"mine"
