import struct

import cv2
import numpy as np
import pytest

from duospacenet.data.images import read_image, read_mask
from duospacenet.runtime.errors import InputError
from tests.helpers.image_files import HEIGHT, WIDTH, encode, smooth_image, write_file


@pytest.fixture
def pixels():
    return smooth_image()


def with_exif_rotation(jpeg):
    """Return the JPEG file with an EXIF orientation of 90 degrees."""
    tiff = struct.pack("<2sHLHHHLLL", b"II", 42, 8, 1, 0x0112, 3, 1, 6, 0)
    segment = b"Exif\0\0" + tiff
    return jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(segment) + 2) + segment + jpeg[2:]


def test_a_png_file_gives_its_pixels_in_bgr_order(tmp_path, pixels):
    image = read_image(write_file(tmp_path, encode(pixels, ".png")), WIDTH, HEIGHT)
    assert (image.dtype, image.shape) == (np.uint8, (HEIGHT, WIDTH, 3))
    assert np.array_equal(image, pixels)


@pytest.mark.parametrize("progressive", [0, 1])
def test_a_jpeg_file_gives_its_pixels_in_bgr_order(tmp_path, pixels, progressive):
    data = encode(pixels, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 98, cv2.IMWRITE_JPEG_PROGRESSIVE, progressive)
    image = read_image(write_file(tmp_path, data), WIDTH, HEIGHT)
    assert np.abs(image.astype(int) - pixels).max() < 12


def test_a_grey_image_and_one_with_alpha_and_one_of_16_bits_become_bgr(tmp_path, pixels):
    grey = read_image(write_file(tmp_path, encode(pixels[..., 0], ".png")), WIDTH, HEIGHT)
    assert np.array_equal(grey, np.repeat(pixels[..., :1], 3, axis=-1))
    alpha = np.dstack([pixels, pixels[..., 0]])
    assert np.array_equal(read_image(write_file(tmp_path, encode(alpha, ".png")), WIDTH, HEIGHT), pixels)
    deep = pixels.astype(np.uint16) * 257
    assert np.array_equal(read_image(write_file(tmp_path, encode(deep, ".png")), WIDTH, HEIGHT), pixels)


def test_an_exif_rotation_is_not_applied(tmp_path, pixels):
    jpeg = encode(pixels, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 98)
    rotated = with_exif_rotation(jpeg)
    assert cv2.imdecode(np.frombuffer(rotated, np.uint8), cv2.IMREAD_COLOR).shape == (WIDTH, HEIGHT, 3)
    image = read_image(write_file(tmp_path, rotated), WIDTH, HEIGHT)
    assert np.array_equal(image, read_image(write_file(tmp_path, jpeg), WIDTH, HEIGHT))


def test_padding_after_the_end_of_a_jpeg_is_accepted(tmp_path, pixels):
    path = write_file(tmp_path, encode(pixels, ".jpg") + bytes(512))
    assert read_image(path, WIDTH, HEIGHT).shape == (HEIGHT, WIDTH, 3)


def test_a_mask_is_true_where_its_png_is_not_black(tmp_path):
    mask = np.zeros((6, 4), bool)
    mask[1, 3] = mask[5, 0] = True
    for white in (1, 255):
        path = write_file(tmp_path, encode(mask.astype(np.uint8) * white, ".png"), "mask.png")
        assert read_mask(path).dtype == np.bool_
        assert np.array_equal(read_mask(path), mask)


def test_a_mask_as_a_jpeg_file_is_refused(tmp_path, pixels):
    with pytest.raises(InputError, match=r"expected a mask as a PNG file; got a JPEG file"):
        read_mask(write_file(tmp_path, encode(pixels, ".jpg")))
