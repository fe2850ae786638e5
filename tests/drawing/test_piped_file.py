"""A file that is written through a pipe."""

import errno
from pathlib import Path

import pytest

from duospacenet.drawing.piped_file import CHUNK_BYTES, PipedFile

CONTENT = bytes(range(256)) * (3 * CHUNK_BYTES // 256) + b"end"


def test_the_file_has_the_bytes_that_were_written_to_the_pipe(tmp_path):
    piped = PipedFile(tmp_path / "a")
    with Path(piped.pipe_path).open("wb") as writer:
        writer.write(CONTENT)
    piped.check()
    piped.close()
    piped.close()
    assert (tmp_path / "a").read_bytes() == CONTENT


def test_an_existing_file_is_not_replaced(tmp_path):
    (tmp_path / "a").write_text("kept")
    with pytest.raises(FileExistsError):
        PipedFile(tmp_path / "a")
    assert (tmp_path / "a").read_text() == "kept"


def test_a_full_disk_does_not_block_the_writer_and_is_reported(tmp_path):
    piped = PipedFile(tmp_path / "a")
    piped._file.close()
    piped._file = Path("/dev/full").open("wb", buffering=0)  # noqa: SIM115
    with Path(piped.pipe_path).open("wb") as writer:
        writer.write(CONTENT)
    for _ in range(2):
        with pytest.raises(OSError) as error:
            piped.close()
        assert error.value.errno == errno.ENOSPC
    with pytest.raises(OSError):
        piped.check()
