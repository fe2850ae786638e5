"""The kind of a file by its first bytes, for messages about files that are not JPEG or PNG images."""

import re
from typing import NamedTuple

from .jpeg_file import JPEG_START
from .png_file import PNG_START

COPY_AGAIN = "Copy the file again."
CONVERT = "Convert it to PNG or JPEG."


class FileKind(NamedTuple):
    """A kind of file. start: pattern of its first bytes. remedy: advice for a user who has it instead of an image."""

    name: str
    start: re.Pattern[bytes]
    remedy: str = CONVERT


_KINDS = (
    FileKind("a JPEG file", re.compile(re.escape(JPEG_START)), COPY_AGAIN),
    FileKind("a PNG file", re.compile(re.escape(PNG_START)), COPY_AGAIN),
    FileKind("a git-lfs pointer", re.compile(rb"version https://git-lfs"), "Fetch the content with `git lfs pull`."),
    FileKind("a WebP image", re.compile(rb"RIFF....WEBP", re.DOTALL)),
    FileKind("a GIF image", re.compile(rb"GIF8[79]a")),
    FileKind("a BMP image", re.compile(rb"BM")),
    FileKind("a TIFF image", re.compile(rb"II[*+]\0|MM\0[*+]")),
    FileKind("a HEIC or AVIF image", re.compile(rb"....ftyp(?:hei|hev|mif|msf|avi[fs])", re.DOTALL)),
    FileKind("a JPEG 2000 image", re.compile(rb"\0\0\0\x0cjP  |\xff\x4f\xff\x51")),
    FileKind("a JPEG XL image", re.compile(rb"\0\0\0\x0cJXL |\xff\x0a")),
    FileKind("an OpenEXR image", re.compile(rb"v/1\x01")),
    FileKind("a Netpbm image", re.compile(rb"P[1-7]\s")),
    FileKind("a NumPy array", re.compile(rb"\x93NUMPY")),
    FileKind("a video", re.compile(rb"....ftyp|\x1aE\xdf\xa3|RIFF....AVI ", re.DOTALL), "Extract its frames."),
    FileKind("a PDF document", re.compile(rb"%PDF")),
    FileKind("a compressed archive", re.compile(rb"PK\x03\x04|\x1f\x8b|7z\xbc\xaf|\x28\xb5\x2f\xfd"), "Unpack it."),
    FileKind("a web page", re.compile(rb"\s*<(?:!doctype|html)", re.IGNORECASE), "Download the image itself."),
    FileKind("an XML file", re.compile(rb"\s*<\?xml|\s*<svg")),
)


def describe_file(data: bytes) -> str:
    """Describe the content of a file for a message: its kind, or its first bytes, and its size."""
    if not data:
        return "an empty file"
    kind = _kind(data)
    name = kind.name if kind else f"bytes {data[:4].hex(' ')} ..."
    return f"{name} of {len(data)} bytes"


def remedy_for(data: bytes) -> str:
    """Advice for a file that is not a JPEG or PNG image."""
    kind = _kind(data)
    return kind.remedy if kind else COPY_AGAIN


def _kind(data: bytes) -> FileKind | None:
    return next((kind for kind in _KINDS if kind.start.match(data)), None)
