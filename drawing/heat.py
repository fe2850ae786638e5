"""Heat: how much the features of each cell differ from their mean, as a colour from black to yellow."""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .canvas import Picture

LOW_PERCENT, HIGH_PERCENT = 1.0, 99.7  # these percentiles of a frame's heat are black and the brightest colour
COLOURS = cv2.COLORMAP_INFERNO


class HeatScale(NamedTuple):
    """The heat that is black, and the heat that has the brightest colour."""

    low: float
    high: float


def heat_of(features: ArrayLike) -> NDArray[np.float32]:
    """Return the heat (M, H, W) of features (M, C, H, W) of M images or maps.

    It is the length of the difference between a cell's features and their mean over all cells of all M images. A part
    that is the same everywhere, such as a bias, is no response to the images, so it has no heat. Features that are not
    finite have no heat either.
    """
    features = np.asarray(features, dtype=np.float32)
    if features.size == 0:
        return np.zeros((features.shape[0], *features.shape[2:]), np.float32)
    differences = features - features.mean(axis=(0, 2, 3), keepdims=True, dtype=np.float64).astype(np.float32)
    heat = np.sqrt(np.einsum("mchw,mchw->mhw", differences, differences))
    return np.where(np.isfinite(heat), heat, 0).astype(np.float32)


def scale_of(heat: NDArray[np.float32]) -> HeatScale:
    """The scale of one frame: the percentiles of its heat."""
    if heat.size == 0:
        return HeatScale(0.0, 1.0)
    low, high = np.percentile(heat, [LOW_PERCENT, HIGH_PERCENT])
    return HeatScale(float(low), float(max(high, low + 1e-12)))


def colour_heat(heat: NDArray[np.float32], scale: HeatScale, size_px: tuple[int, int]) -> Picture:
    """Colour the heat (H, W) of one image or map, enlarged to `size_px`: (height, width, 3) uint8 BGR."""
    enlarged = cv2.resize(heat, size_px, interpolation=cv2.INTER_LINEAR)
    share = np.clip((enlarged - scale.low) / (scale.high - scale.low), 0, 1)
    return np.asarray(cv2.applyColorMap(np.rint(255 * share).astype(np.uint8), COLOURS), dtype=np.uint8)
