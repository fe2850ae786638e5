"""Reads image files, after checks of size, depth and completeness, and writes PNG files atomically."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..runtime.errors import InputError, OutputError
from ..runtime.files import read_regular_file, write_atomically
from .file_kind import COPY_AGAIN, describe_file, remedy_for
from .image_decoding import DamagedImageError, ImageHeader
from .jpeg_file import JPEG_START, decode_jpeg, jpeg_header
from .png_file import PNG_START, decode_png, png_header

MAX_IMAGE_PX = 100_000_000  # larger images are never decoded, even if the calibration has their size
MAX_FILE_BYTES = 8 * MAX_IMAGE_PX  # an uncompressed PNG of 16 bits and four channels

_COLOUR = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION


def read_image(path: Path, width_px: int, height_px: int, reduction: int = 1) -> NDArray[np.uint8]:
    """Read a JPEG or PNG file of a known size. Returns (height_px, width_px, 3) uint8 BGR.

    reduction: of the width and height of JPEG files, as for `decode_jpeg`. Other files are not reduced.
    A rotation in the EXIF data is not applied, because the calibration refers to the sensor's pixels.
    Raises InputError, naming the path, for a file that is missing, truncated, damaged, of another size, or of more
    than 8 bits per channel.
    """
    return decode_image(_read(path), str(path), width_px, height_px, reduction)


def decode_image(data: bytes, name: str, width_px: int, height_px: int, reduction: int = 1) -> NDArray[np.uint8]:
    """Decode the content of a JPEG or PNG file of a known size. Returns (height_px, width_px, 3) uint8 BGR.

    name: of the image, for messages. reduction: as for `read_image`.
    Raises InputError, naming the image, as `read_image` does.
    """
    header = _check_header(name, data, (width_px, height_px))
    _check_depth(name, header)
    return _decode(name, data, header, reduction=reduction)


def check_image_header(path: Path, width_px: int, height_px: int) -> None:
    """Check an image file by its header alone, before `read_image`. No pixel is decoded, so damage is not found.

    Raises InputError, naming the path, for a file that is missing, of another kind or size, or of more than 8 bits
    per channel.
    """
    data = _read(path, start_only=True)
    if png_header(data) is None and jpeg_header(data) is None:  # the header of a JPEG may be far from the start
        data = _read(path)
    _check_depth(path, _check_header(path, data, (width_px, height_px)))


def read_image_size(path: Path) -> tuple[int, int]:
    """Return the width and height [px] in the header of a JPEG or PNG file. No pixel is decoded.

    Raises InputError, naming the path, for a file that is missing or neither JPEG nor PNG.
    """
    header = _check_header(path, _read(path), None)
    return header.width_px, header.height_px


def read_mask(path: Path) -> NDArray[np.bool_]:
    """Read a PNG file as a mask (rows, columns) bool, true where it is not black. It may have 16 bits per channel.

    Raises InputError as `read_image` does.
    """
    data = _read(path)
    header = _check_mask(path, data)
    # Without ANYDEPTH, a value below 256 in a file of 16 bits would become 0.
    return np.asarray(_decode(path, data, header, _COLOUR | cv2.IMREAD_ANYDEPTH).any(axis=2), np.bool_)


def check_mask_header(path: Path) -> None:
    """Check a mask file by its header alone, before `read_mask`. Raises InputError, naming the path."""
    _check_mask(path, _read(path, start_only=True))


def read_png(path: Path) -> NDArray[np.uint8]:
    """Read an image that `write_png` wrote: (height, width, 3) uint8 BGR. Raises InputError as `read_image`."""
    data = _read(path)
    return _decode(path, data, _check_header(path, data, None))


def write_png(path: Path | str, image: NDArray[np.uint8]) -> None:
    """Write an image (height, width, 3) uint8 BGR, or (height, width) grey, as a PNG file, atomically.

    Raises OutputError, naming the path, if it cannot be written.
    """
    encoded, data = cv2.imencode(".png", image)
    if not encoded:
        raise OutputError(f"cannot write {path}: OpenCV could not encode an image of shape {image.shape}")
    write_atomically(path, data.tobytes())


def _read(path: Path, start_only: bool = False) -> bytes:
    try:
        exists = path.exists()
    except OSError:  # such as a name of more than 255 bytes
        exists = True
    if not exists:
        raise InputError(
            f"{path}: expected an image file; got no such file. Is the path relative to the folder of its scene? "
            "For a lost camera, set the image to null."
        )
    return read_regular_file(path, MAX_FILE_BYTES, InputError, start_only)


def _check_header(name: Path | str, data: bytes, expected_px: tuple[int, int] | None) -> ImageHeader:
    """Return the header, after a check of the size in it. No pixel is decoded."""
    header = png_header(data) or jpeg_header(data)
    if header is None:
        lack = " without the header of an image" if data.startswith((JPEG_START, PNG_START)) else ""
        raise InputError(f"{name}: expected a JPEG or PNG image; got {describe_file(data)}{lack}. {remedy_for(data)}")
    size_px = (header.width_px, header.height_px)
    got = f"{size_px[0]}x{size_px[1]} px"
    if expected_px is not None and size_px != expected_px:
        raise InputError(
            f"{name}: expected {expected_px[0]}x{expected_px[1]} px, as the calibration says; got {got}. "
            "Correct width_px and height_px with the intrinsics, or use the original image."
        )
    if not 0 < size_px[0] * size_px[1] <= MAX_IMAGE_PX:
        raise InputError(f"{name}: expected an image of 1 to {MAX_IMAGE_PX} pixels; got {got}. Scale it down.")
    return header


def _check_mask(path: Path, data: bytes) -> ImageHeader:
    if not data.startswith(PNG_START):
        raise InputError(f"{path}: expected a mask as a PNG file; got {describe_file(data)}.")
    return _check_header(path, data, None)


def _check_depth(name: Path | str, header: ImageHeader) -> None:
    # Whether the values fill all 16 bits, or only 10 or 12 of them, is not known.
    if header.bits > 8:
        raise InputError(
            f"{name}: expected 8 bits per channel; got {header.bits}. Scale the values to 0 to 255 and save the image "
            "again. For 12-bit values, for example, divide by 16."
        )


def _decode(
    name: Path | str, data: bytes, header: ImageHeader, png_flags: int = _COLOUR, reduction: int = 1
) -> NDArray:
    try:
        return decode_png(data, png_flags) if data.startswith(PNG_START) else decode_jpeg(data, header, reduction)
    except DamagedImageError as error:
        raise InputError(
            f"{name}: expected an undamaged image; got {describe_file(data)} {error}. {_remedy(data)}"
        ) from None


def _remedy(data: bytes) -> str:
    if data.startswith(PNG_START):
        return COPY_AGAIN
    return (
        f"{COPY_AGAIN} If the camera writes all its files like this, and they look right, rewrite them without loss: "
        "`jpegtran in.jpg > out.jpg`."
    )
