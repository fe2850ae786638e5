"""Photometric distortion of camera images: brightness, contrast, saturation and hue.

The operations and their ranges are those of mmdetection's PhotoMetricDistortion, without its swap of colour channels.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

LARGEST_BRIGHTNESS = 32.0  # grey levels
CONTRASTS = SATURATIONS = (0.5, 1.5)
LARGEST_HUE_DEG = 18.0

Image = NDArray[np.uint8]


@dataclass(frozen=True)
class PhotometricDistortion:
    """One distortion. The defaults change nothing.

    brightness: added to all channels [grey levels].
    contrast: factor of all channels.
    saturation: factor of the saturation (HSV).
    hue_deg: added to the hue (HSV) [degrees].
    contrast_first: apply the contrast before saturation and hue, and not after them.
    """

    brightness: float = 0.0
    contrast: float = 1.0
    saturation: float = 1.0
    hue_deg: float = 0.0
    contrast_first: bool = True

    def __call__(self, image: Image) -> Image:
        """Distort an image (H, W, 3) uint8 in BGR order. The image is not changed. Values are clipped to 0 to 255."""
        before, after = (self.contrast, 1.0) if self.contrast_first else (1.0, self.contrast)
        levels = np.arange(256, dtype=np.float32) + np.float32(self.brightness)
        levels = (levels * np.float32(before)).clip(0, 255)
        if self.saturation == 1 and self.hue_deg == 0:  # without the rounding errors of HSV
            return _as_image(cv2.LUT(image, _round(levels * np.float32(after))))
        colours = self._distort_colours(np.asarray(cv2.LUT(image, levels), np.float32))
        return _as_image(cv2.convertScaleAbs(colours, alpha=after))

    def _distort_colours(self, values: NDArray[np.float32]) -> NDArray[np.float32]:
        """Change the hue and the saturation of float32 colours from 0 to 255."""
        hsv = np.asarray(cv2.cvtColor(values, cv2.COLOR_BGR2HSV), np.float32)  # degrees, 0 to 1, 0 to 255
        hsv[..., 0] += self.hue_deg  # OpenCV takes hues beyond 360 degrees as well
        np.minimum(hsv[..., 1] * np.float32(self.saturation), 1, out=hsv[..., 1])
        return np.asarray(cv2.cvtColor(hsv, cv2.COLOR_HSV2BGR), np.float32)


def sample_photometric_distortion(rng: np.random.Generator) -> PhotometricDistortion:
    """Sample a distortion. Each of the four operations is applied with probability 1/2."""
    # All numbers are always sampled, so that no operation changes the random numbers of the others.
    applied = rng.random(4) < 0.5
    first = bool(rng.random() < 0.5)
    brightness = rng.uniform(-LARGEST_BRIGHTNESS, LARGEST_BRIGHTNESS)
    contrast, saturation = rng.uniform(*CONTRASTS), rng.uniform(*SATURATIONS)
    hue_deg = rng.uniform(-LARGEST_HUE_DEG, LARGEST_HUE_DEG)
    return PhotometricDistortion(
        brightness if applied[0] else 0.0,
        contrast if applied[1] else 1.0,
        saturation if applied[2] else 1.0,
        hue_deg if applied[3] else 0.0,
        first,
    )


def _round(levels: NDArray[np.float32]) -> Image:
    return np.rint(levels).clip(0, 255).astype(np.uint8)


def _as_image(values: cv2.typing.MatLike) -> Image:
    return np.asarray(values, np.uint8)
