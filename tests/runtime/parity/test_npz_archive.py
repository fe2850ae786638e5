"""NPZ archives from others: a header that no array has is refused before any memory is taken."""

import zipfile

import numpy as np
import pytest

from duospacenet.runtime.errors import ArtifactError
from duospacenet.runtime.parity.npz_archive import NpzArchive

HEADERS = {
    "more elements than memory": "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000000000000,)}",
    "a negative shape": "{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}",
    "no type": "{'descr': (), 'fortran_order': False, 'shape': (1,)}",
    "a type that is none": "{'descr': None, 'fortran_order': False, 'shape': (1,)}",
    "Python objects": "{'descr': '|O', 'fortran_order': False, 'shape': (1,)}",
    "brackets without an end": "(" * 500,
}


def write_array(path, header):
    text = f"{header}\n".encode()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("values.npy", b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text)


@pytest.mark.parametrize("header", HEADERS.values(), ids=HEADERS.keys())
def test_a_header_that_no_array_has_is_refused(header, tmp_path):
    write_array(tmp_path / "hostile.npz", header)
    with (
        NpzArchive(tmp_path / "hostile.npz", ArtifactError) as archive,
        pytest.raises(ArtifactError, match=r"hostile\.npz: array 'values': cannot be read"),
    ):
        archive.read("values", (4,), ("float32",))


def test_an_array_that_unpacks_to_more_bytes_than_expected_is_not_read(tmp_path):
    np.savez_compressed(tmp_path / "bomb.npz", values=np.zeros(10**6, np.float32))
    with (
        NpzArchive(tmp_path / "bomb.npz", ArtifactError) as archive,
        pytest.raises(ArtifactError, match="expected at most 65552 bytes; got 4000128"),
    ):
        archive.read("values", (4,), ("float32",))
