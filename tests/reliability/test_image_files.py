"""Image files that cannot be trusted: row T5 of the reliability list."""

import struct

import cv2
import numpy as np
import pytest

from duospacenet.data.images import MAX_IMAGE_PX, read_image, read_mask
from duospacenet.runtime.errors import InputError
from tests.helpers.image_files import HEIGHT, WIDTH, encode, png_with_size, smooth_image, write_file


@pytest.fixture
def picture():
    return smooth_image()


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_t5_a_truncated_file_is_refused_at_any_length(tmp_path, picture, suffix):
    data = encode(picture, suffix)
    for percent in range(1, 100):
        path = write_file(tmp_path, data[: len(data) * percent // 100], "cut" + suffix)
        with pytest.raises(InputError, match=r"cut\.\w+: expected a .*; got .*Copy the file again"):
            read_image(path, WIDTH, HEIGHT)


def test_t5_a_truncated_jpeg_with_a_thumbnail_is_refused(tmp_path, picture):
    thumbnail = encode(picture[::4, ::4], ".jpg")
    segment = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    jpeg = encode(picture, ".jpg")
    whole = jpeg[:2] + segment + jpeg[2:]
    assert read_image(write_file(tmp_path, whole), WIDTH, HEIGHT).shape == (HEIGHT, WIDTH, 3)
    for length, words in ((2 + len(segment), "expected a JPEG or PNG image"), (len(whole) - 9, "without its end")):
        with pytest.raises(InputError, match=words):
            read_image(write_file(tmp_path, whole[:length]), WIDTH, HEIGHT)
        with pytest.raises(InputError, match=words):
            read_image(write_file(tmp_path, whole[:length].ljust(len(whole), b"\0")), WIDTH, HEIGHT)


def test_t5_a_damaged_png_is_refused(tmp_path, picture):
    data = bytearray(encode(picture, ".png"))
    data[len(data) // 2] ^= 1
    with pytest.raises(InputError, match=r"image\.jpg: expected an image; got a PNG file .* cannot be decoded"):
        read_image(write_file(tmp_path, bytes(data)), WIDTH, HEIGHT)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("size", [(WIDTH + 1, HEIGHT), (WIDTH, HEIGHT - 1), (HEIGHT, WIDTH)])
def test_t5_another_size_than_the_calibrations_is_refused(tmp_path, picture, suffix, size):
    path = write_file(tmp_path, encode(picture, suffix))
    with pytest.raises(InputError, match=f"expected {size[0]}x{size[1]} px, as the calibration says; got 64x48 px"):
        read_image(path, *size)


def test_t5_a_decompression_bomb_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    def decode(*_):
        raise AssertionError("decoded")

    monkeypatch.setattr(cv2, "imdecode", decode)
    path = write_file(tmp_path, png_with_size(30_000, 30_000))
    with pytest.raises(InputError, match="expected 64x48 px, as the calibration says; got 30000x30000 px"):
        read_image(path, WIDTH, HEIGHT)
    with pytest.raises(InputError, match=f"expected an image of 1 to {MAX_IMAGE_PX} pixels; got 30000x30000 px"):
        read_image(path, 30_000, 30_000)
    with pytest.raises(InputError, match=f"expected an image of 1 to {MAX_IMAGE_PX} pixels; got 30000x30000 px"):
        read_mask(path)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "got an empty file"),
        (b"\xff\xd8\xff", "got a JPEG file of 3 bytes"),
        (b"\x89PNG\r\n\x1a\n", "got a PNG file of 8 bytes"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "got a git-lfs pointer of 56 bytes"),
        (b"BM" + bytes(100), "got bytes 42 4d 00 00 ... of 102 bytes"),
        (bytes(1000), "got bytes 00 00 00 00 ... of 1000 bytes"),
    ],
)
def test_t5_what_is_no_image_is_refused_by_name(tmp_path, data, words):
    with pytest.raises(InputError, match=r"image\.jpg: expected a JPEG or PNG image; ") as error:
        read_image(write_file(tmp_path, data), WIDTH, HEIGHT)
    assert words in str(error.value)


def test_t5_random_bytes_never_raise_anything_else(tmp_path, picture):
    rng = np.random.default_rng(0)
    for suffix in (".jpg", ".png"):
        data = encode(picture, suffix)
        for _ in range(200):
            spoilt = bytearray(data)
            for at in rng.integers(0, len(data), 8):
                spoilt[at] = rng.integers(256)
            try:
                image = read_image(write_file(tmp_path, bytes(spoilt)), WIDTH, HEIGHT)
            except InputError:
                continue
            assert (image.dtype, image.shape) == (np.uint8, (HEIGHT, WIDTH, 3))


@pytest.mark.parametrize("name", ["missing.jpg", "folder", "a\0b", "x" * 300, "\ud800.jpg", "file.jpg/inside"])
def test_t5_what_cannot_be_read_is_refused(tmp_path, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file.jpg").write_bytes(b"")
    with pytest.raises(InputError, match=r"expected an image file; got no such file|cannot be read"):
        read_image(tmp_path / name, WIDTH, HEIGHT)
