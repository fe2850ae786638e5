"""PNG files: all colour types, and damage in every chunk."""

import zlib

import cv2
import numpy as np
import pytest

from duospacenet.data.image_decoding import DamagedImageError, ImageHeader
from duospacenet.data.png_file import decode_png, png_header
from tests.helpers.image_files import encode, png_chunks, png_file, png_header_chunk, smooth_image

LEVELS = np.arange(6 * 8).reshape(6, 8)  # rows of eight pixels


def decode(data):
    return decode_png(data, cv2.IMREAD_COLOR)


def packed_png(values, bits, colour_type=0, *chunks):
    """Return a PNG file of single-channel values, packed into `bits` each."""
    as_bits = (values[..., None] >> np.arange(bits)[::-1]) & 1
    rows = np.packbits(as_bits.reshape(len(values), -1), axis=1)
    pixels = b"".join(b"\0" + row.tobytes() for row in rows)
    header = png_header_chunk(values.shape[1], len(values), bits, colour_type)
    return png_file(header, *chunks, (b"IDAT", zlib.compress(pixels)))


@pytest.mark.parametrize("bits", [1, 2, 4, 8])
def test_grey_values_of_less_than_8_bits_are_scaled_to_the_full_range(bits):
    values = LEVELS % 2**bits
    expected = np.rint(values * (255 / (2**bits - 1)))
    assert np.array_equal(decode(packed_png(values, bits)), np.repeat(expected[..., None], 3, axis=2))


@pytest.mark.parametrize("bits", [1, 4, 8])
def test_a_palette_gives_its_colours(bits):
    palette = np.random.default_rng(0).integers(0, 256, (2**bits, 3), np.uint8)
    values = LEVELS % 2**bits
    data = packed_png(values, bits, 3, (b"PLTE", palette.tobytes()), (b"tRNS", bytes(2)))
    assert png_header(data) == ImageHeader(8, 6, bits, 3)
    assert np.array_equal(decode(data), palette[values][..., ::-1])


def test_chunks_of_colour_management_and_text_do_not_change_the_pixels():
    image = smooth_image()
    header, *rest = png_chunks(encode(image, ".png"))
    gamma, text = (b"gAMA", (100_000).to_bytes(4)), (b"tEXt", b"Comment\0a car")
    assert np.array_equal(decode(png_file(header, gamma, text, *rest)), image)


@pytest.mark.parametrize("kind", [b"IHDR", b"gAMA", b"IDAT", b"tEXt", b"IEND"])
def test_a_wrong_checksum_in_any_chunk_is_refused(kind):
    header, *rest = png_chunks(encode(smooth_image(), ".png"))
    data = bytearray(png_file(header, (b"gAMA", (45455).to_bytes(4)), *rest, (b"tEXt", b"Comment\0a car")))
    data[data.rindex(kind) + 4] ^= 1
    with pytest.raises(DamagedImageError, match=r"with a wrong checksum between bytes \d+ and \d+"):
        decode(bytes(data))


def test_a_chunk_of_pixels_that_is_missing_is_refused():
    image = np.random.default_rng(0).integers(0, 256, (100, 100, 3), np.uint8)
    header, *pixels = png_chunks(encode(image, ".png"))
    assert len(pixels) > 2
    for missing in range(len(pixels)):
        with pytest.raises(DamagedImageError, match="with pixels that cannot be decoded"):
            decode(png_file(header, *pixels[:missing], *pixels[missing + 1 :]))


def test_a_file_without_an_end_is_refused_whatever_follows():
    data = encode(smooth_image(), ".png")[:-12]
    for tail in (b"", b"\0" * 100, b"IEND", (10**9).to_bytes(4) + b"tEXt"):
        with pytest.raises(DamagedImageError):
            decode(data + tail)


@pytest.mark.parametrize("data", [b"", b"\x89PNG\r\n\x1a\n", b"\x89PNG\r\n\x1a\n\0\0\0\x0dIDAT" + bytes(30)])
def test_a_file_that_does_not_start_with_a_header_has_none(data):
    assert png_header(data) is None
