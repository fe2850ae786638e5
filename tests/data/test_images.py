import struct
import zlib

import cv2
import numpy as np
import pytest

from duospacenet.data.images import read_image, read_mask
from duospacenet.runtime.errors import InputError
from tests.helpers.image_files import HEIGHT, WIDTH, encode, png_file, png_header_chunk, smooth_image, write_file


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


def test_a_grey_image_and_one_with_alpha_become_bgr(tmp_path, pixels):
    grey = read_image(write_file(tmp_path, encode(pixels[..., 0], ".png")), WIDTH, HEIGHT)
    assert np.array_equal(grey, np.repeat(pixels[..., :1], 3, axis=-1))
    alpha = np.dstack([pixels, pixels[..., 0]])
    assert np.array_equal(read_image(write_file(tmp_path, encode(alpha, ".png")), WIDTH, HEIGHT), pixels)
    jpeg = read_image(write_file(tmp_path, encode(pixels[..., 0], ".jpg")), WIDTH, HEIGHT)
    assert np.abs(jpeg.astype(int) - pixels[..., :1]).max() < 4


@pytest.mark.parametrize("colour_type", [0, 2, 4, 6])
def test_an_image_of_16_bits_is_refused_and_the_message_says_how_to_convert_it(tmp_path, colour_type):
    row = bytes(1 + 2 * WIDTH * {0: 1, 2: 3, 4: 2, 6: 4}[colour_type])
    chunks = png_header_chunk(WIDTH, HEIGHT, 16, colour_type), (b"IDAT", zlib.compress(row * HEIGHT))
    with pytest.raises(InputError, match=r"image\.jpg: expected 8 bits per channel; got 16\. Scale the values"):
        read_image(write_file(tmp_path, png_file(*chunks)), WIDTH, HEIGHT)


def test_a_jpeg_of_12_bits_is_refused(tmp_path, pixels):
    data = bytearray(encode(pixels, ".jpg"))
    data[data.index(b"\xff\xc0") + 4] = 12  # after the marker and the length of the start-of-frame segment
    with pytest.raises(InputError, match="expected 8 bits per channel; got 12"):
        read_image(write_file(tmp_path, bytes(data)), WIDTH, HEIGHT)


def test_an_exif_rotation_is_not_applied(tmp_path, pixels):
    jpeg = encode(pixels, ".jpg", cv2.IMWRITE_JPEG_QUALITY, 98)
    rotated = with_exif_rotation(jpeg)
    assert cv2.imdecode(np.frombuffer(rotated, np.uint8), cv2.IMREAD_COLOR).shape == (WIDTH, HEIGHT, 3)
    image = read_image(write_file(tmp_path, rotated), WIDTH, HEIGHT)
    assert np.array_equal(image, read_image(write_file(tmp_path, jpeg), WIDTH, HEIGHT))


def test_a_mask_is_true_where_its_png_is_not_black(tmp_path):
    mask = np.zeros((6, 4), bool)
    mask[1, 3] = mask[5, 0] = True
    for white in (1, 255):
        path = write_file(tmp_path, encode(mask.astype(np.uint8) * white, ".png"), "mask.png")
        assert read_mask(path).dtype == np.bool_
        assert np.array_equal(read_mask(path), mask)


def test_a_mask_of_16_bits_is_true_where_any_of_them_is_set(tmp_path):
    values = np.array([[0, 1, 255, 256], [65535, 0, 0, 4095]], np.uint16)
    path = write_file(tmp_path, encode(values, ".png"), "mask.png")
    assert np.array_equal(read_mask(path), values > 0)


def test_a_mask_in_colour_is_true_where_any_channel_is_not_zero(tmp_path):
    colours = np.zeros((2, 3, 3), np.uint8)
    colours[0, 0, 0] = colours[1, 1, 2] = 1
    path = write_file(tmp_path, encode(colours, ".png"), "mask.png")
    assert read_mask(path).tolist() == [[True, False, False], [False, True, False]]


def test_a_mask_as_a_jpeg_file_is_refused(tmp_path, pixels):
    with pytest.raises(InputError, match=r"expected a mask as a PNG file; got a JPEG file"):
        read_mask(write_file(tmp_path, encode(pixels, ".jpg")))
