import struct
import zlib

import cv2
import numpy as np
import pytest

from duospacenet.runtime.errors import InputError
from duospacenet.runtime.images import LARGEST_PX, read_image, read_mask

WIDTH, HEIGHT = 64, 48


@pytest.fixture
def picture():
    """Smooth, so that JPEG keeps it, with another slope in each colour."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([4 * column, 5 * row, 255 - 4 * column], axis=-1).clip(0, 255).astype(np.uint8)


def encoded(picture, suffix, *parameters):
    return cv2.imencode(suffix, picture, parameters)[1].tobytes()


def with_exif_rotation(jpeg):
    """The JPEG file with a note that it is to be shown turned by a quarter."""
    tiff = struct.pack("<2sHLHHHLLL", b"II", 42, 8, 1, 0x0112, 3, 1, 6, 0)
    segment = b"Exif\0\0" + tiff
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + jpeg[2:]


def png_of(width, height):
    """A PNG file whose header claims any size, over a few bytes of pixels."""

    def chunk(kind, data):
        return struct.pack(">L", len(data)) + kind + data + struct.pack(">L", zlib.crc32(kind + data))

    header = struct.pack(">LLBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = zlib.compress(bytes(1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def file_of(tmp_path, data, name="image.jpg"):
    path = tmp_path / name
    path.write_bytes(data)
    return path


def test_a_png_file_gives_its_pixels_in_bgr_order(tmp_path, picture):
    image = read_image(file_of(tmp_path, encoded(picture, ".png")), WIDTH, HEIGHT)
    assert (image.dtype, image.shape) == (np.uint8, (HEIGHT, WIDTH, 3))
    assert np.array_equal(image, picture)


@pytest.mark.parametrize("progressive", [0, 1])
def test_a_jpeg_file_gives_its_pixels_in_bgr_order(tmp_path, picture, progressive):
    data = encoded(picture, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 98, cv2.IMWRITE_JPEG_PROGRESSIVE, progressive)
    image = read_image(file_of(tmp_path, data), WIDTH, HEIGHT)
    assert np.abs(image.astype(int) - picture).max() < 12


def test_a_grey_image_and_one_with_alpha_and_one_of_16_bits_become_bgr(tmp_path, picture):
    grey = read_image(file_of(tmp_path, encoded(picture[..., 0], ".png")), WIDTH, HEIGHT)
    assert np.array_equal(grey, np.repeat(picture[..., :1], 3, axis=-1))
    alpha = np.dstack([picture, picture[..., 0]])
    assert np.array_equal(read_image(file_of(tmp_path, encoded(alpha, ".png")), WIDTH, HEIGHT), picture)
    deep = picture.astype(np.uint16) * 257
    assert np.array_equal(read_image(file_of(tmp_path, encoded(deep, ".png")), WIDTH, HEIGHT), picture)


def test_a_rotation_noted_in_exif_is_not_applied(tmp_path, picture):
    jpeg = encoded(picture, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 98)
    turned = with_exif_rotation(jpeg)
    assert cv2.imdecode(np.frombuffer(turned, np.uint8), cv2.IMREAD_COLOR).shape == (WIDTH, HEIGHT, 3)
    image = read_image(file_of(tmp_path, turned), WIDTH, HEIGHT)
    assert np.array_equal(image, read_image(file_of(tmp_path, jpeg), WIDTH, HEIGHT))


def test_padding_after_the_end_of_a_jpeg_is_accepted(tmp_path, picture):
    path = file_of(tmp_path, encoded(picture, ".jpg") + bytes(512))
    assert read_image(path, WIDTH, HEIGHT).shape == (HEIGHT, WIDTH, 3)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_a_truncated_file_is_refused_at_any_length(tmp_path, picture, suffix):
    data = encoded(picture, suffix)
    for percent in range(1, 100):
        path = file_of(tmp_path, data[: len(data) * percent // 100], "cut" + suffix)
        with pytest.raises(InputError, match=r"cut\.\w+: expected a .*; got .*Copy the file again"):
            read_image(path, WIDTH, HEIGHT)


def test_a_truncated_jpeg_with_a_thumbnail_is_refused(tmp_path, picture):
    thumbnail = encoded(picture[::4, ::4], ".jpg")
    segment = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    jpeg = encoded(picture, ".jpg")
    whole = jpeg[:2] + segment + jpeg[2:]
    assert read_image(file_of(tmp_path, whole), WIDTH, HEIGHT).shape == (HEIGHT, WIDTH, 3)
    for length, words in ((2 + len(segment), "expected a JPEG or PNG image"), (len(whole) - 9, "without its end")):
        with pytest.raises(InputError, match=words):
            read_image(file_of(tmp_path, whole[:length]), WIDTH, HEIGHT)
        with pytest.raises(InputError, match=words):
            read_image(file_of(tmp_path, whole[:length].ljust(len(whole), b"\0")), WIDTH, HEIGHT)


def test_a_damaged_png_is_refused(tmp_path, picture):
    data = bytearray(encoded(picture, ".png"))
    data[len(data) // 2] ^= 1
    with pytest.raises(InputError, match=r"image\.jpg: expected an image; got a PNG file .* cannot be decoded"):
        read_image(file_of(tmp_path, bytes(data)), WIDTH, HEIGHT)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("size", [(WIDTH + 1, HEIGHT), (WIDTH, HEIGHT - 1), (HEIGHT, WIDTH)])
def test_another_size_than_the_calibrations_is_refused(tmp_path, picture, suffix, size):
    path = file_of(tmp_path, encoded(picture, suffix))
    with pytest.raises(InputError, match=f"expected {size[0]}x{size[1]} px, as the calibration says; got 64x48 px"):
        read_image(path, *size)


def test_a_decompression_bomb_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    def decode(*_):
        raise AssertionError("decoded")

    monkeypatch.setattr(cv2, "imdecode", decode)
    path = file_of(tmp_path, png_of(30_000, 30_000))
    with pytest.raises(InputError, match="expected 64x48 px, as the calibration says; got 30000x30000 px"):
        read_image(path, WIDTH, HEIGHT)
    with pytest.raises(InputError, match=f"expected an image of 1 to {LARGEST_PX} pixels; got 30000x30000 px"):
        read_image(path, 30_000, 30_000)
    with pytest.raises(InputError, match=f"expected an image of 1 to {LARGEST_PX} pixels; got 30000x30000 px"):
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
def test_what_is_no_image_is_refused_by_name(tmp_path, data, words):
    with pytest.raises(InputError, match=r"image\.jpg: expected a JPEG or PNG image; ") as error:
        read_image(file_of(tmp_path, data), WIDTH, HEIGHT)
    assert words in str(error.value)


def test_random_bytes_never_raise_anything_else(tmp_path, picture):
    rng = np.random.default_rng(0)
    for suffix in (".jpg", ".png"):
        data = encoded(picture, suffix)
        for _ in range(200):
            spoilt = bytearray(data)
            for at in rng.integers(0, len(data), 8):
                spoilt[at] = rng.integers(256)
            try:
                image = read_image(file_of(tmp_path, bytes(spoilt)), WIDTH, HEIGHT)
            except InputError:
                continue
            assert (image.dtype, image.shape) == (np.uint8, (HEIGHT, WIDTH, 3))


@pytest.mark.parametrize("name", ["missing.jpg", "folder", "a\0b", "x" * 300, "\ud800.jpg", "file.jpg/inside"])
def test_what_cannot_be_read_is_refused(tmp_path, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file.jpg").write_bytes(b"")
    with pytest.raises(InputError, match=r"expected an image file; got no such file|cannot be read"):
        read_image(tmp_path / name, WIDTH, HEIGHT)


def test_a_mask_is_true_where_its_png_is_not_black(tmp_path):
    mask = np.zeros((6, 4), bool)
    mask[1, 3] = mask[5, 0] = True
    for white in (1, 255):
        path = file_of(tmp_path, encoded(mask.astype(np.uint8) * white, ".png"), "mask.png")
        assert read_mask(path).dtype == np.bool_
        assert np.array_equal(read_mask(path), mask)


def test_a_mask_that_a_jpeg_has_blurred_is_refused(tmp_path, picture):
    with pytest.raises(InputError, match=r"expected a mask as a PNG file; got a JPEG file"):
        read_mask(file_of(tmp_path, encoded(picture, ".jpg")))
