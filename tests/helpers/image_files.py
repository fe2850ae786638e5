"""Image files as bytes, for tests of reading them."""

import struct
import zlib

import cv2
import numpy as np

WIDTH, HEIGHT = 64, 48


def smooth_picture():
    """Smooth, so that JPEG keeps it, with another slope in each colour."""
    row, column = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([4 * column, 5 * row, 255 - 4 * column], axis=-1).clip(0, 255).astype(np.uint8)


def encoded(picture, suffix, *parameters):
    return cv2.imencode(suffix, picture, parameters)[1].tobytes()


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
