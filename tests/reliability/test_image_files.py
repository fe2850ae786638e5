"""Reliability rows T5 and T11: damaged, truncated and malicious image files, and unusual but legal ones."""

import struct

import cv2
import numpy as np
import pytest

from duospacenet.data.images import MAX_IMAGE_PX, read_image, read_mask
from duospacenet.runtime.errors import InputError
from tests.helpers.image_files import HEIGHT, WIDTH, encode, photo, png_with_size, smooth_image, write_file

BLOCK = 4096  # of a file system
PHOTO_SIZE = (640, 480)
PHOTO_FILES = {
    "baseline": (".jpg", cv2.IMWRITE_JPEG_QUALITY, 90),
    "optimised": (".jpg", cv2.IMWRITE_JPEG_QUALITY, 90, cv2.IMWRITE_JPEG_OPTIMIZE, 1),
    "restart markers": (".jpg", cv2.IMWRITE_JPEG_QUALITY, 90, cv2.IMWRITE_JPEG_RST_INTERVAL, 16),
    "progressive": (".jpg", cv2.IMWRITE_JPEG_QUALITY, 90, cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    "progressive with restart markers": (
        *(".jpg", cv2.IMWRITE_JPEG_QUALITY, 90),
        *(cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 16),
    ),
    "png": (".png",),
}


@pytest.fixture
def image():
    return smooth_image()


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_t5_a_truncated_file_is_refused_at_any_length(tmp_path, image, suffix):
    data = encode(image, suffix)
    for percent in range(1, 100):
        path = write_file(tmp_path, data[: len(data) * percent // 100], "cut" + suffix)
        with pytest.raises(InputError, match=r"cut\.\w+: expected an? .*; got .*Copy the file again"):
            read_image(path, WIDTH, HEIGHT)


def test_t5_a_truncated_jpeg_with_a_thumbnail_is_refused(tmp_path, image):
    thumbnail = encode(image[::4, ::4], ".jpg")
    segment = b"\xff\xe1" + struct.pack(">H", len(thumbnail) + 2) + thumbnail
    jpeg = encode(image, ".jpg")
    whole = jpeg[:2] + segment + jpeg[2:]
    assert read_image(write_file(tmp_path, whole), WIDTH, HEIGHT).shape == (HEIGHT, WIDTH, 3)
    for length, message in (
        (2 + len(segment), "expected a JPEG or PNG image"),
        (len(whole) - 9, "Premature end of JPEG"),
    ):
        with pytest.raises(InputError, match=message):
            read_image(write_file(tmp_path, whole[:length]), WIDTH, HEIGHT)
        with pytest.raises(InputError, match=message):
            read_image(write_file(tmp_path, whole[:length].ljust(len(whole), b"\0")), WIDTH, HEIGHT)


def test_t5_a_damaged_png_is_refused(tmp_path, image):
    data = bytearray(encode(image, ".png"))
    data[len(data) // 2] ^= 1
    with pytest.raises(InputError, match=r"image\.jpg: expected an undamaged image; got a PNG file .* wrong checksum"):
        read_image(write_file(tmp_path, bytes(data)), WIDTH, HEIGHT)


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
@pytest.mark.parametrize("size", [(WIDTH + 1, HEIGHT), (WIDTH, HEIGHT - 1), (HEIGHT, WIDTH)])
def test_t5_an_image_that_does_not_have_the_calibrated_size_is_refused(tmp_path, image, suffix, size):
    path = write_file(tmp_path, encode(image, suffix))
    with pytest.raises(InputError, match=f"expected {size[0]}x{size[1]} px, as the calibration says; got 64x48 px"):
        read_image(path, *size)


def test_t5_a_decompression_bomb_is_refused_before_it_is_decoded(tmp_path, monkeypatch):
    def decode(*_):
        raise AssertionError("the image was decoded")

    monkeypatch.setattr(cv2, "imdecode", decode)
    path = write_file(tmp_path, png_with_size(30_000, 30_000))
    with pytest.raises(InputError, match="expected 64x48 px, as the calibration says; got 30000x30000 px"):
        read_image(path, WIDTH, HEIGHT)
    with pytest.raises(InputError, match=f"expected an image of 1 to {MAX_IMAGE_PX} pixels; got 30000x30000 px"):
        read_image(path, 30_000, 30_000)
    with pytest.raises(InputError, match=f"expected an image of 1 to {MAX_IMAGE_PX} pixels; got 30000x30000 px"):
        read_mask(path)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "got an empty file"),
        (b"\xff\xd8\xff", "got a JPEG file of 3 bytes without the header of an image"),
        (b"\x89PNG\r\n\x1a\n", "got a PNG file of 8 bytes"),
        (
            b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n",
            "got a git-lfs pointer of 56 bytes. Fetch the content with `git lfs pull`",
        ),
        (b"BM" + bytes(100), "got a BMP image of 102 bytes. Convert it to PNG or JPEG"),
        (bytes(1000), "got bytes 00 00 00 00 ... of 1000 bytes"),
    ],
)
def test_t5_a_file_that_is_not_an_image_is_refused_with_its_kind(tmp_path, data, message):
    with pytest.raises(InputError, match=r"image\.jpg: expected a JPEG or PNG image; ") as error:
        read_image(write_file(tmp_path, data), WIDTH, HEIGHT)
    assert message in str(error.value)


@pytest.mark.parametrize("kind", PHOTO_FILES)
def test_t11_a_file_with_a_hole_at_any_tenth_of_it_is_refused(tmp_path, kind):
    """Start and end of the file are intact: a block of the disk was lost, or a download skipped a part."""
    data = encode(photo(*PHOTO_SIZE), *PHOTO_FILES[kind])
    assert read_image(write_file(tmp_path, data), *PHOTO_SIZE).shape == (480, 640, 3)
    for start in range(len(data) // 10, len(data) - BLOCK - 2, len(data) // 10):
        rest = data[start + BLOCK :]
        holes = [data[:start] + filling + rest for filling in (bytes(BLOCK), b"\xff" * BLOCK, b"")]
        for damaged in [*holes, data[: start // 3] + data[start // 3 + len(data) * 7 // 10 :]]:
            with pytest.raises(InputError, match=r"image\.jpg: expected an undamaged image; .*Copy the file again"):
                read_image(write_file(tmp_path, damaged), *PHOTO_SIZE)


@pytest.mark.parametrize("kind", PHOTO_FILES)
def test_t11_a_truncated_file_with_an_end_marker_is_refused(tmp_path, kind):
    data = encode(photo(*PHOTO_SIZE), *PHOTO_FILES[kind])
    end = data[-2:] if data.endswith(b"\xff\xd9") else data[-12:]
    for tenth in range(1, 10):
        with pytest.raises(InputError, match="expected an undamaged image"):
            read_image(write_file(tmp_path, data[: len(data) * tenth // 10] + end), *PHOTO_SIZE)


TRAILERS = {
    "one zero": b"\0",
    "padding to a block": bytes(BLOCK),
    "fill bytes": b"\xff" * 16,
    "a line end": b"\r\n",
    "the trailer of a phone": b"\0\0\1\nImage_UTC_Data1533151604547SEFHk\0\0\0SEFT",
    "a second image": encode(smooth_image()[::2, ::2], ".jpg"),  # as in an MPO file
    "half of a second image": encode(smooth_image(), ".jpg")[:500],
    "an archive": b"PK\x03\x04" + bytes(range(256)) * 8,
    "a chunk of PNG": b"\0\0\0\x04tEXt1234",
}


@pytest.mark.parametrize("trailer", TRAILERS)
@pytest.mark.parametrize("kind", ["baseline", "progressive", "png"])
def test_t11_bytes_after_the_end_of_an_image_do_not_change_it(tmp_path, image, kind, trailer):
    whole = encode(image, *PHOTO_FILES[kind])
    expected = cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_COLOR)
    path = write_file(tmp_path, whole + TRAILERS[trailer])
    assert np.array_equal(read_image(path, WIDTH, HEIGHT), expected)
    end = -2 if whole.endswith(b"\xff\xd9") else -12
    with pytest.raises(InputError, match="expected an undamaged image"):
        read_image(write_file(tmp_path, whole[:end] + TRAILERS[trailer]), WIDTH, HEIGHT)


def test_t11_the_decoders_print_nothing_about_damaged_files(tmp_path, capfd):
    """Their messages on stderr would not name the file."""
    for kind in PHOTO_FILES:
        data = encode(photo(*PHOTO_SIZE), *PHOTO_FILES[kind])
        middle = len(data) // 2
        with pytest.raises(InputError):
            read_image(write_file(tmp_path, data[:middle] + bytes(BLOCK) + data[middle + BLOCK :]), *PHOTO_SIZE)
    assert capfd.readouterr() == ("", "")


def test_t5_a_file_of_absurd_size_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "sparse.png"
    with path.open("wb") as file:
        file.truncate(60 * 10**9)
    with pytest.raises(InputError, match=r"sparse\.png: expected a file of at most 800000000 bytes; got 60000000000"):
        read_image(path, WIDTH, HEIGHT)


def test_t5_random_damage_raises_input_errors_only(tmp_path, image):
    rng = np.random.default_rng(0)
    for suffix in (".jpg", ".png"):
        data = encode(image, suffix)
        for _ in range(200):
            damaged = bytearray(data)
            for offset in rng.integers(0, len(data), 8):
                damaged[offset] = rng.integers(256)
            try:
                decoded = read_image(write_file(tmp_path, bytes(damaged)), WIDTH, HEIGHT)
            except InputError:
                continue
            assert (decoded.dtype, decoded.shape) == (np.uint8, (HEIGHT, WIDTH, 3))


@pytest.mark.parametrize("name", ["missing.jpg", "folder", "a\0b", "x" * 300, "\ud800.jpg", "file.jpg/inside"])
def test_t5_a_path_that_cannot_be_read_is_refused(tmp_path, name):
    (tmp_path / "folder").mkdir()
    (tmp_path / "file.jpg").write_bytes(b"")
    with pytest.raises(
        InputError,
        match=r"got no such file|cannot be read|got a folder",
    ):
        read_image(tmp_path / name, WIDTH, HEIGHT)
