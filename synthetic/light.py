"""The light of a drawn drive, and the two textures that carry it: the sky all round, and the ground's grain."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

GRAIN_TILE_PX = 512
GRAIN_PX_PER_M = 14.0
PANORAMA_PX_PER_DEG = 4.0
PANORAMA_TOP_DEG = 40.0
PANORAMA_BOTTOM_DEG = -4.0


@dataclass(frozen=True)
class Light:
    """Colours are BGR, 0..255; sun_direction is a unit vector to the sun, in the global frame."""

    sun_direction: Array
    ambient: float
    sun: float
    tint: Array
    haze: Array
    zenith: Array
    haze_distance_m: float
    cloudiness: float

    def shade(self, colours: Array, normals: Array, sun_direction: Array) -> Array:
        """Light colours (F, 3) on faces with unit normals (F, 3), in the frame of the direction to the sun (3,)."""
        direct = np.maximum(normals @ sun_direction, 0.0)
        from_sky = self.ambient * (0.9 + 0.1 * normals[:, 2])
        return colours * ((from_sky + self.sun * direct)[:, None] * self.tint)

    def veil(self, colours: Array, distances_m: Array) -> Array:
        """Colours (F, 3) as seen through the haze over (F,) distances, as 0..255."""
        kept = np.exp(-distances_m / self.haze_distance_m)[:, None]
        return np.clip(kept * colours + (1 - kept) * self.haze, 0, 255)


def sample_light(rng: np.random.Generator) -> Light:
    """One of a clear day, an overcast day and an evening."""
    kind = rng.choice(3, p=[0.5, 0.3, 0.2])
    azimuth, elevation = rng.uniform(-np.pi, np.pi), np.radians((48.0, 60.0, 24.0)[kind] + rng.uniform(-10, 10))
    level = rng.uniform(0.8, 1.1)
    return Light(
        sun_direction=np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        ),
        ambient=(0.62, 0.86, 0.52)[kind] * level,
        sun=(0.55, 0.1, 0.42)[kind] * level,
        tint=np.array([(0.97, 1.0, 1.03), (1.03, 1.0, 0.98), (0.84, 0.95, 1.1)][kind]),
        haze=np.array([(232, 214, 198), (205, 202, 199), (165, 190, 228)][kind]) * min(level, 1.0),
        zenith=np.array([(222, 160, 98), (186, 182, 178), (165, 125, 100)][kind]) * min(level, 1.0),
        haze_distance_m=(260.0, 170.0, 200.0)[kind],
        cloudiness=(0.5, 0.9, 0.65)[kind],
    )


def paint_grain(rng: np.random.Generator) -> Image:
    """A tile (512, 512) of ground brightness round 128 that repeats without a seam."""
    shape = (GRAIN_TILE_PX, GRAIN_TILE_PX)
    grain = sum(
        strength * _wrapped_noise(rng, shape, (blur, blur)) for blur, strength in ((0.8, 6.0), (4.0, 5.0), (12.0, 6.0))
    )
    return np.clip(128 + grain, 60, 196).astype(np.uint8)


def paint_panorama(rng: np.random.Generator, light: Light, ground: Array) -> Image:
    """The horizon all round: column 0 looks along azimuth 0 (global x), then to the left; the top row is highest."""
    width = int(360 * PANORAMA_PX_PER_DEG)
    height = int((PANORAMA_TOP_DEG - PANORAMA_BOTTOM_DEG) * PANORAMA_PX_PER_DEG)
    elevation_deg = (PANORAMA_TOP_DEG - (np.arange(height) + 0.5) / PANORAMA_PX_PER_DEG)[:, None, None]
    rise = np.clip(elevation_deg / 24.0, 0, 1) ** 0.7
    sky = light.haze * (1 - rise) + light.zenith * rise
    clouds = _wrapped_noise(rng, (height, width), (5, 26)) + 0.5 * _wrapped_noise(rng, (height, width), (2, 7))
    cover = np.clip((clouds + 2 * light.cloudiness - 1.2) * 0.5, 0, 0.85)[:, :, None]
    white = np.minimum(light.haze * 1.12, 250)
    sky = sky * (1 - cover * np.clip(elevation_deg / 4, 0, 1)) + white * cover * np.clip(elevation_deg / 4, 0, 1)
    for mean, swing, blur, kept, colour in (
        (1.5, 0.8, 60, 0.3, (120, 105, 80)),
        (0.9, 0.45, 4, 0.5, (70, 92, 72)),
    ):
        ridge_deg = mean + swing * _wrapped_noise(rng, (1, width), (0, blur))[0]
        hill = light.haze * (1 - kept) + np.array(colour) * light.ambient * kept
        covered = np.clip((ridge_deg[None, :, None] - elevation_deg) * PANORAMA_PX_PER_DEG + 0.5, 0, 1)
        sky = sky * (1 - covered) + hill * covered
    return np.where(elevation_deg < 0, ground, sky).clip(0, 255).astype(np.uint8)


def _wrapped_noise(
    rng: np.random.Generator, shape: tuple[int, int], blur_px: tuple[float, float]
) -> NDArray[np.float32]:
    """Smooth noise of unit variance that repeats without a seam; blur_px: in rows and in columns."""
    pad = [min(int(4 * blur), size) for blur, size in zip(blur_px, shape, strict=True)]
    noise = np.pad(rng.standard_normal(shape, dtype=np.float32), [(pad[0],) * 2, (pad[1],) * 2], mode="wrap")
    smooth = cv2.GaussianBlur(noise, (0, 0), sigmaX=max(blur_px[1], 0.1), sigmaY=max(blur_px[0], 0.1))
    smooth = smooth[pad[0] : pad[0] + shape[0], pad[1] : pad[1] + shape[1]]
    return (smooth - smooth.mean()) / smooth.std()
