"""JPEG files: the header, and decoding that refuses damaged data.

libjpeg repairs damaged data and only prints a warning. OpenCV ignores the warning; simplejpeg raises an exception.
Both use libjpeg-turbo and give the same pixels bit for bit.
"""

import re
from collections.abc import Iterator
from typing import Final

import cv2
import numpy as np
import simplejpeg
from numpy.typing import NDArray

from .image_decoding import DamagedImageError, ImageHeader, decode_with_opencv

JPEG_START: Final = b"\xff\xd8\xff"
MAX_SCANS: Final = 100  # progressive files have about 10; a small file with thousands takes minutes to decode

SIZE_MARKERS: Final = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}  # the SOF markers, without DHT, JPG and DAC
SCAN_MARKER: Final = 0xDA
END_MARKER: Final = 0xD9
FILL: Final = 0xFF
CMYK_CHANNELS: Final = 4

# In the data of a scan, FF 00 is the byte FF, and FF D0 to FF D7 are restart markers.
_MARKER_AFTER_SCAN = re.compile(rb"\xff[\x01-\xcf\xd8-\xfe]")


def jpeg_header(data: bytes) -> ImageHeader | None:
    """Return the header of a JPEG file, or None if it is another file or has no start-of-frame segment."""
    if not data.startswith(JPEG_START):
        return None
    frame = next((payload for marker, payload in _segments(data) if marker in SIZE_MARKERS), b"")
    if len(frame) < 6:
        return None
    # The height is stored before the width.
    return ImageHeader(int.from_bytes(frame[3:5]), int.from_bytes(frame[1:3]), bits=frame[0], channels=frame[5])


def decode_jpeg(data: bytes, header: ImageHeader, reduction: int = 1) -> NDArray[np.uint8]:
    """Decode a JPEG file to (height, width, 3) uint8 BGR. A rotation in its EXIF data is not applied.

    reduction: 1, 2, 4 or 8, a divisor of width and height. libjpeg computes the smaller image from the low frequencies
        of each block, which is faster than a whole one. The checks are the same, because it reads all data. A CMYK
        file is never reduced.
    Bytes after the end marker are ignored.
    Raises DamagedImageError if libjpeg reports damage. JPEG has no checksum, so a few wrong bytes can stay undetected.
    """
    _check_scans(data, header.channels)
    is_cmyk = header.channels == CMYK_CHANNELS
    # libjpeg takes the largest reduction that keeps these sizes; 0 is for the file's own size.
    smallest = (0, 0) if reduction == 1 or is_cmyk else (header.height_px // reduction, header.width_px // reduction)
    try:
        # A file with a second size is found before it is decoded, since its image may be huge.
        height, width, *_ = simplejpeg.decode_jpeg_header(data)
        if (height, width) != (header.height_px, header.width_px):
            raise DamagedImageError(f"with a second size of {width}x{height} px")
        colours = "CMYK" if is_cmyk else "BGR"
        image = simplejpeg.decode_jpeg(data, colours, min_height=smallest[0], min_width=smallest[1], strict=True)
    except ValueError as error:
        raise DamagedImageError(f"of which libjpeg reports '{error}'") from None
    # libjpeg does not convert CMYK to BGR. OpenCV does, and is called only after libjpeg has found no damage.
    return decode_with_opencv(data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION) if is_cmyk else image


def _check_scans(data: bytes, num_channels: int) -> None:
    """Check the number of scans, and that they contain all colour channels, which libjpeg does not check."""
    scans = [payload for marker, payload in _segments(data) if marker == SCAN_MARKER]
    if len(scans) > MAX_SCANS:
        raise DamagedImageError(f"with {len(scans)} scans, where at most {MAX_SCANS} are accepted")
    # A scan lists its channels as pairs of channel and tables, after their number.
    channels = {channel for scan in scans if scan for channel in scan[1 : 1 + 2 * scan[0] : 2]}
    if len(channels) < num_channels:
        raise DamagedImageError(f"with data for {len(channels)} of {num_channels} colour channels")


def _segments(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Yield marker and payload of each segment up to the end marker, or to the place where the structure is broken.

    Segments are skipped by their lengths, so a thumbnail inside one of them is not taken for the image.
    """
    offset = 2
    while offset + 4 <= len(data) and data[offset] == 0xFF and data[offset + 1] != END_MARKER:
        marker = data[offset + 1]
        if marker == FILL:
            offset += 1
            continue
        end = offset + 2 + int.from_bytes(data[offset + 2 : offset + 4])
        yield marker, data[offset + 4 : end]
        offset = end
        if marker == SCAN_MARKER:
            found = _MARKER_AFTER_SCAN.search(data, end)
            offset = found.start() if found else len(data)
