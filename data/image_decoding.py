"""What the readers of JPEG and PNG files share: the header, the error for damage, and OpenCV's decoder."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray


class ImageHeader(NamedTuple):
    """The header of an image file.

    width_px, height_px: size of the image.
    bits: per channel.
    channels: number of colour channels in the file.
    """

    width_px: int
    height_px: int
    bits: int
    channels: int


class DamagedImageError(Exception):
    """An image file is damaged. The message continues the words "a JPEG file", for example with "without its end"."""


def decode_with_opencv(data: bytes, flags: int) -> NDArray:
    """Decode an image file. flags: of `cv2.imdecode`. Raises DamagedImageError if OpenCV cannot decode it."""
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        image = None
    if image is None:
        raise DamagedImageError("with pixels that cannot be decoded")
    return image
