"""The light of a synthetic drive: sun, sky and haze."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Light:
    """The light of one drive. Colours are BGR, 0..255.

    sun_direction: unit vector to the sun in the global frame.
    ambient: factor of the light from the sky.
    sun: factor of the direct sunlight.
    tint: (3,) factors of blue, green and red.
    haze, zenith: (3,) colours of the sky at the horizon and at the top.
    haze_distance_m: distance at which 1/e of an object's colour remains.
    cloudiness: 0 to 1.
    """

    sun_direction: Array
    ambient: float
    sun: float
    tint: Array
    haze: Array
    zenith: Array
    haze_distance_m: float
    cloudiness: float

    def shade(self, colours: Array, normals: Array, sun_direction: Array) -> Array:
        """Colours (F, 3) of faces after lighting, not clipped.

        colours: (F, 3) before lighting.
        normals: (F, 3) unit normals of the faces.
        sun_direction: (3,) in the frame of the normals.
        """
        direct = np.maximum(normals @ sun_direction, 0.0)
        from_sky = self.ambient * (0.9 + 0.1 * normals[:, 2])
        return colours * ((from_sky + self.sun * direct)[:, None] * self.tint)

    def add_haze(self, colours: Array, distances_m: Array) -> Array:
        """Mix colours (F, 3) with the haze over (F,) distances; the result is in 0..255."""
        transmittance = np.exp(-distances_m / self.haze_distance_m)[:, None]
        return np.clip(transmittance * colours + (1 - transmittance) * self.haze, 0, 255)


def sample_light(rng: np.random.Generator) -> Light:
    """Sample the light of a clear day (probability 0.5), an overcast day (0.3) or an evening (0.2)."""
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
