"""PNG files: the header, and decoding after a check of all chunks."""

import zlib
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .image_decoding import DamagedImageError, ImageHeader, decode_with_opencv

PNG_START: Final = b"\x89PNG\r\n\x1a\n"
HEADER_KIND: Final = b"IHDR"
HEADER_BYTES: Final = 13
END_KIND: Final = b"IEND"
CHANNELS: Final = {0: 1, 2: 3, 3: 3, 4: 1, 6: 3}  # by colour type, without alpha
CHUNK_OVERHEAD: Final = 12  # length, kind and checksum, four bytes each


def png_header(data: bytes) -> ImageHeader | None:
    """Return the header of a PNG file, or None if it is another file or does not start with its header."""
    start = len(PNG_START) + 8  # after the length and the kind of the chunk
    if not data.startswith(PNG_START) or data[start - 4 : start] != HEADER_KIND or len(data) < start + HEADER_BYTES:
        return None
    fields = data[start : start + HEADER_BYTES]
    bits, colour_type = fields[8], fields[9]
    return ImageHeader(int.from_bytes(fields[:4]), int.from_bytes(fields[4:8]), bits, CHANNELS.get(colour_type, 0))


def decode_png(data: bytes, flags: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Decode a PNG file. flags: of `cv2.imdecode`. Bytes after the last chunk are ignored.

    Raises DamagedImageError for a missing end, a wrong checksum, or pixels that cannot be decoded.
    """
    return decode_with_opencv(data[: _checked_length(data)], flags)


def _checked_length(data: bytes) -> int:
    """Return the length up to the end of the last chunk. Raises DamagedImageError for a wrong checksum or no end."""
    # libpng checks only the chunks that it needs, and prints its errors on stderr.
    offset, view = len(PNG_START), memoryview(data)
    while offset + CHUNK_OVERHEAD <= len(data):
        end = offset + CHUNK_OVERHEAD + int.from_bytes(data[offset : offset + 4])
        if end > len(data):
            break
        if zlib.crc32(view[offset + 4 : end - 4]) != int.from_bytes(data[end - 4 : end]):
            raise DamagedImageError(f"with a wrong checksum between bytes {offset} and {end}")
        if data[offset + 4 : offset + 8] == END_KIND:
            return end
        offset = end
    raise DamagedImageError("without its end")
