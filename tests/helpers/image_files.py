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


def encode(image, suffix, *parameters):
    """Return the bytes of an image file. parameters: of `cv2.imwrite`."""
    return cv2.imencode(suffix, image, parameters)[1].tobytes()


def png_with_size(width, height):
    """Return a PNG file with any size in its header, and only a few bytes of pixels."""

    def chunk(kind, data):
        return struct.pack(">L", len(data)) + kind + data + struct.pack(">L", zlib.crc32(kind + data))

    header = struct.pack(">LLBBBBB", width, height, 8, 2, 0, 0, 0)
    pixels = zlib.compress(bytes(1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixels) + chunk(b"IEND", b"")


def write_file(tmp_path, data, name="image.jpg"):
    path = tmp_path / name
    path.write_bytes(data)
    return path
