"""The textures of a synthetic drive: the panorama of the sky, and the grain of the ground."""

import cv2
import numpy as np
from numpy.typing import NDArray

from .light import Light

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

GRAIN_TILE_PX = 512
GRAIN_PX_PER_M = 14.0
PANORAMA_PX_PER_DEG = 4.0
PANORAMA_TOP_DEG = 40.0
PANORAMA_BOTTOM_DEG = -4.0


def ground_grain(rng: np.random.Generator) -> Image:
    """A tile (512, 512) of the brightness of the ground, around 128. It repeats without a seam."""
    shape = (GRAIN_TILE_PX, GRAIN_TILE_PX)
    grain = sum(
        strength * _periodic_noise(rng, shape, (blur, blur)) for blur, strength in ((0.8, 6.0), (4.0, 5.0), (12.0, 6.0))
    )
    return np.clip(128 + grain, 60, 196).astype(np.uint8)


def sky_panorama(rng: np.random.Generator, light: Light, ground: Array) -> Image:
    """Sky and hills at all azimuths, (H, W, 3) BGR.

    Column 0 is azimuth 0 (global x), and azimuth increases with the column, counter-clockwise seen from above. Row 0
    is the highest elevation.

    ground: (3,) colour below the horizon.
    """
    width = int(360 * PANORAMA_PX_PER_DEG)
    height = int((PANORAMA_TOP_DEG - PANORAMA_BOTTOM_DEG) * PANORAMA_PX_PER_DEG)
    elevation_deg = (PANORAMA_TOP_DEG - (np.arange(height) + 0.5) / PANORAMA_PX_PER_DEG)[:, None, None]
    rise = np.clip(elevation_deg / 24.0, 0, 1) ** 0.7
    sky = light.haze * (1 - rise) + light.zenith * rise
    clouds = _periodic_noise(rng, (height, width), (5, 26)) + 0.5 * _periodic_noise(rng, (height, width), (2, 7))
    cover = np.clip((clouds + 2 * light.cloudiness - 1.2) * 0.5, 0, 0.85)[:, :, None]
    white = np.minimum(light.haze * 1.12, 250)
    sky = sky * (1 - cover * np.clip(elevation_deg / 4, 0, 1)) + white * cover * np.clip(elevation_deg / 4, 0, 1)
    # Two ridges of hills, the farther one first.
    for mean, swing, blur, transmittance, colour in (
        (1.5, 0.8, 60, 0.3, (120, 105, 80)),
        (0.9, 0.45, 4, 0.5, (70, 92, 72)),
    ):
        ridge_deg = mean + swing * _periodic_noise(rng, (1, width), (0, blur))[0]
        hill = light.haze * (1 - transmittance) + np.array(colour) * light.ambient * transmittance
        covered = np.clip((ridge_deg[None, :, None] - elevation_deg) * PANORAMA_PX_PER_DEG + 0.5, 0, 1)
        sky = sky * (1 - covered) + hill * covered
    return np.where(elevation_deg < 0, ground, sky).clip(0, 255).astype(np.uint8)


def _periodic_noise(
    rng: np.random.Generator, shape: tuple[int, int], blur_px: tuple[float, float]
) -> NDArray[np.float32]:
    """Smooth noise of unit variance that repeats without a seam; blur_px: vertical and horizontal sigma."""
    pad = [min(int(4 * blur), size) for blur, size in zip(blur_px, shape, strict=True)]
    noise = np.pad(rng.standard_normal(shape, dtype=np.float32), [(pad[0],) * 2, (pad[1],) * 2], mode="wrap")
    smooth = cv2.GaussianBlur(noise, (0, 0), sigmaX=max(blur_px[1], 0.1), sigmaY=max(blur_px[0], 0.1))
    smooth = smooth[pad[0] : pad[0] + shape[0], pad[1] : pad[1] + shape[1]]
    return (smooth - smooth.mean()) / smooth.std()
