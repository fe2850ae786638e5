"""Image files as bytes, for tests of the image reader."""

import struct
import zlib

import cv2
import numpy as np

WIDTH, HEIGHT = 64, 48


def smooth_image():
    """Return an image with a different linear gradient in each colour. JPEG keeps it almost unchanged."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([4 * column, 5 * row, 255 - 4 * column], axis=-1).clip(0, 255).astype(np.uint8)


def photo(width=640, height=480):
    """Return an image with smooth areas and noise. As a JPEG file, it has about 60 KB."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (height // 40, width // 40, 3), np.uint8)
    smooth = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC).astype(int)
    return np.clip(smooth + rng.integers(-6, 7, smooth.shape), 0, 255).astype(np.uint8)


def encode(image, suffix, *parameters):
    """Return the bytes of an image file. parameters: of `cv2.imwrite`."""
    return cv2.imencode(suffix, image, parameters)[1].tobytes()


def png_file(*chunks):
    """Return a PNG file of the given chunks, each a pair of kind and data, and the end chunk."""
    parts = [
        struct.pack(">L", len(data)) + kind + data + struct.pack(">L", zlib.crc32(kind + data))
        for kind, data in (*chunks, (b"IEND", b""))
    ]
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)


def png_header_chunk(width, height, bits=8, colour_type=2, interlace=0):
    return b"IHDR", struct.pack(">LLBBBBB", width, height, bits, colour_type, 0, 0, interlace)


def png_with_size(width, height):
    """Return a PNG file with any size in its header, and only a few bytes of pixels."""
    return png_file(png_header_chunk(width, height), (b"IDAT", zlib.compress(bytes(1000))))


def png_chunks(data):
    """Return the chunks of a PNG file, without the end chunk, as pairs of kind and data."""
    chunks, offset = [], 8
    while offset < len(data):
        end = offset + 8 + int.from_bytes(data[offset : offset + 4])
        chunks.append((data[offset + 4 : offset + 8], data[offset + 8 : end]))
        offset = end + 4
    return chunks[:-1]


def write_file(tmp_path, data, name="image.jpg"):
    path = tmp_path / name
    path.write_bytes(data)
    return path
