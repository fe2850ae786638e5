"""Reads image files, after checks of size and completeness, and writes PNG files atomically."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError, OutputError
from ..runtime.files import write_atomically

MAX_IMAGE_PX = 100_000_000  # larger images are never decoded, even if the calibration has their size

PNG_START = b"\x89PNG\r\n\x1a\n\x00\x00\x00\rIHDR"
PNG_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"
JPEG_START = b"\xff\xd8\xff"
JPEG_END = b"\xff\xd9"
JPEG_SIZE_MARKERS = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # the SOF markers, without DHT, JPG and DAC
JPEG_FILL = 0xFF
LFS_START = b"version https://git-lfs"

_COPY_AGAIN = "Copy the file again."


def read_image(path: Path, width_px: int, height_px: int) -> NDArray[np.uint8]:
    """Read a JPEG or PNG file of a known size. Returns (height_px, width_px, 3) uint8 BGR.

    A rotation in the EXIF data is not applied, because the calibration refers to the sensor's pixels.
    Raises InputError, naming the path, for a file that is missing, truncated, damaged or of another size.
    """
    data = _read(path)
    _check_size(path, data, (width_px, height_px))
    return _decode(path, data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)


def read_image_size(path: Path) -> tuple[int, int]:
    """Return the width and height [px] in the header of a JPEG or PNG file. No pixel is decoded.

    Raises InputError, naming the path, for a file that is missing, truncated or neither JPEG nor PNG.
    """
    return _check_size(path, _read(path), None)


def read_mask(path: Path) -> NDArray[np.bool_]:
    """Read a PNG file as a mask (rows, columns) bool, true where it is not black. Raises InputError as `read_image`."""
    data = _read(path)
    if not data.startswith(PNG_START):
        raise InputError(f"{path}: expected a mask as a PNG file; got {_kind(data)}.")
    _check_size(path, data, None)
    return _decode(path, data, cv2.IMREAD_GRAYSCALE) > 0


def read_png(path: Path) -> NDArray[np.uint8]:
    """Read an image that `write_png` wrote: (height, width, 3) uint8 BGR. Raises InputError as `read_image`."""
    data = _read(path)
    _check_size(path, data, None)
    return _decode(path, data, cv2.IMREAD_COLOR)


def write_png(path: Path | str, image: NDArray[np.uint8]) -> None:
    """Write an image (height, width, 3) uint8 BGR, or (height, width) grey, as a PNG file, atomically.

    Raises OutputError, naming the path, if it cannot be written.
    """
    encoded, data = cv2.imencode(".png", image)
    if not encoded:
        raise OutputError(f"cannot write {path}: OpenCV could not encode an image of shape {image.shape}")
    write_atomically(path, data.tobytes())


def _read(path: Path) -> bytes:
    try:
        if not path.is_file():
            raise InputError(
                f"{path}: expected an image file; got no such file. Is the path relative to the folder of its scene? "
                "For a lost camera, set the image to null."
            )
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from None


def _check_size(path: Path, data: bytes, expected: tuple[int, int] | None) -> tuple[int, int]:
    """Return the size in the header. Checks this size and that the file is complete. No pixel is decoded."""
    size = _png_size(data) if data.startswith(PNG_START) else _jpeg_size(data)
    if size is None:
        raise InputError(f"{path}: expected a JPEG or PNG image; got {_kind(data)}. {_remedy(data)}")
    got = f"{size[0]}x{size[1]} px"
    if expected is not None and size != expected:
        raise InputError(
            f"{path}: expected {expected[0]}x{expected[1]} px, as the calibration says; got {got}. "
            "Correct width_px and height_px with the intrinsics, or use the original image."
        )
    if not 0 < size[0] * size[1] <= MAX_IMAGE_PX:
        raise InputError(f"{path}: expected an image of 1 to {MAX_IMAGE_PX} pixels; got {got}. Scale it down.")
    complete = data.endswith(PNG_END) if data.startswith(PNG_START) else data.rstrip(b"\0").endswith(JPEG_END)
    if not complete:
        raise InputError(f"{path}: expected a complete image; got {len(data)} bytes without its end. {_COPY_AGAIN}")
    return size


def _decode(path: Path, data: bytes, flags: int) -> NDArray[np.uint8]:
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        image = None
    if image is None:
        raise InputError(f"{path}: expected an image; got {_kind(data)} that cannot be decoded. {_COPY_AGAIN}")
    return np.asarray(image, dtype=np.uint8)


def _png_size(data: bytes) -> tuple[int, int] | None:
    offset = len(PNG_START)
    if len(data) < offset + 8:
        return None
    return int.from_bytes(data[offset : offset + 4]), int.from_bytes(data[offset + 4 : offset + 8])


def _jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Return the size in the start-of-frame segment; None if there is no such segment."""
    if not data.startswith(JPEG_START):
        return None
    offset = 2
    # The segments are skipped by their lengths, so a thumbnail inside one of them is not taken for the image.
    while offset + 9 <= len(data) and data[offset] == 0xFF:
        marker = data[offset + 1]
        if marker in JPEG_SIZE_MARKERS:  # the height is stored before the width
            return int.from_bytes(data[offset + 7 : offset + 9]), int.from_bytes(data[offset + 5 : offset + 7])
        offset += 1 if marker == JPEG_FILL else 2 + int.from_bytes(data[offset + 2 : offset + 4])
    return None


def _remedy(data: bytes) -> str:
    """Advice for a file that is not an image."""
    return "Fetch the content with `git lfs pull`." if data.startswith(LFS_START) else _COPY_AGAIN


def _kind(data: bytes) -> str:
    """Describe the content of a file for an error message: its format, or its first bytes, and its size."""
    if not data:
        return "an empty file"
    known = {"a JPEG file": JPEG_START, "a PNG file": PNG_START[:8], "a git-lfs pointer": LFS_START}
    kind = next((kind for kind, start in known.items() if data.startswith(start)), f"bytes {data[:4].hex(' ')} ...")
    return f"{kind} of {len(data)} bytes"
