import cv2
import numpy as np
import pytest

from duospacenet.data.file_kind import describe_file, remedy_for
from tests.helpers.image_files import encode, smooth_image


@pytest.mark.parametrize(
    ("suffix", "kind"),
    [
        (".webp", "a WebP image"),
        (".bmp", "a BMP image"),
        (".tiff", "a TIFF image"),
        (".gif", "a GIF image"),
        (".jp2", "a JPEG 2000 image"),
        (".ppm", "a Netpbm image"),
        (".avif", "a HEIC or AVIF image"),
    ],
)
def test_images_of_other_formats_are_named(suffix, kind):
    if not cv2.haveImageWriter(suffix):
        pytest.skip(f"this OpenCV writes no {suffix}")
    data = encode(smooth_image(), suffix)
    assert describe_file(data) == f"{kind} of {len(data)} bytes"
    assert remedy_for(data) == "Convert it to PNG or JPEG."


@pytest.mark.parametrize(
    ("data", "kind", "remedy"),
    [
        (b"\n<!DOCTYPE html><html>", "a web page", "Download the image itself."),
        (b"PK\x03\x04" + bytes(10), "a compressed archive", "Unpack it."),
        (b"\0\0\0\x18ftypisom" + bytes(10), "a video", "Extract its frames."),
        (b"\0\0\0\x18ftypheic" + bytes(10), "a HEIC or AVIF image", "Convert it to PNG or JPEG."),
        (b"\0\1\2\3\4", "bytes 00 01 02 03 ...", "Copy the file again."),
    ],
)
def test_other_files_are_named_with_advice(data, kind, remedy):
    assert describe_file(data) == f"{kind} of {len(data)} bytes"
    assert remedy_for(data) == remedy


def test_an_array_that_was_saved_by_numpy_is_named(tmp_path):
    np.save(tmp_path / "image.npy", smooth_image())
    assert describe_file((tmp_path / "image.npy").read_bytes()).startswith("a NumPy array of ")


def test_an_empty_file_is_named():
    assert describe_file(b"") == "an empty file"
