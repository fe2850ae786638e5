"""Overlaps of images: what two cameras see of the same distant things.

The matches between the images of two cameras must have the same directions in the ego frame. This is compared for the
calibrations as given, for exchanged ones and for turned ones. It works at any speed, and also for a parked vehicle.
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..runtime.frame import Camera
from ..runtime.geometry import rotation_z
from .image_features import Features, Matches, match_features
from .optics import pixel_rays

Array = NDArray[np.float64]

# Two cameras of a car are up to about a metre apart, and see a thing at 15 m in directions that differ by 4 degrees.
LARGEST_PARALLAX_DEG = 4.0
LARGEST_CHORD = 2 * np.sin(np.radians(LARGEST_PARALLAX_DEG) / 2)


class PairMatches(NamedTuple):
    """The matches of two cameras in one frame. cameras: the calibrations of this frame, by name."""

    cameras: Mapping[str, Camera]
    matches: Matches


class ImageOverlaps:
    """The matches between all pairs of cameras, collected over some frames."""

    def __init__(self) -> None:
        self._pairs: dict[tuple[str, str], list[PairMatches]] = {}
        self._calibration_of: dict[str, str] = {}  # for exchanged cameras, the camera whose calibration is used

    def add(self, cameras: Mapping[str, Camera], features: Mapping[str, Features]) -> None:
        """Add the images of one frame. cameras, features: by name; cameras without features are not compared."""
        for one, other in combinations(features, 2):
            matches = match_features(features[one], features[other])
            if len(matches.one_px):
                self._pairs.setdefault((one, other), []).append(PairMatches(cameras, matches))

    def exchanged(self, pair: tuple[str, str]) -> "ImageOverlaps":
        """The same matches, with the calibrations of two cameras exchanged."""
        result = ImageOverlaps()
        result._pairs = self._pairs
        given = [self._calibration_of.get(name, name) for name in pair]
        result._calibration_of = {**self._calibration_of, pair[0]: given[1], pair[1]: given[0]}
        return result

    def num_agreeing(self, names: Iterable[str]) -> int:
        """The number of matches of some cameras, with each other and with others, that agree with the calibrations."""
        return sum(map(self.num_agreeing_pair, (pair for pair in self._pairs if set(pair) & set(names))))

    def num_agreeing_pair(self, pair: tuple[str, str], yaw_deg: float = 0.0) -> int:
        """The number of matches of two cameras that agree with their calibrations.

        yaw_deg: turns the second camera to the left.
        """
        pair, yaw_deg = (pair, yaw_deg) if pair in self._pairs else (pair[::-1], -yaw_deg)
        turn = rotation_z(np.radians(yaw_deg))
        return sum(_num_equal(one, other @ turn.T) for one, other in self._ego_rays(pair))

    def partners(self, name: str) -> list[str]:
        """The cameras that have matches with a camera."""
        return [other if one == name else one for one, other in self._pairs if name in (one, other)]

    def _ego_rays(self, pair: tuple[str, str]) -> Iterator[tuple[Array, Array]]:
        """The directions (M, 3) in the ego frame of the matches of two cameras, one pair of arrays per frame."""
        for cameras, matches in self._pairs.get(pair, ()):
            one, other = (cameras.get(self._calibration_of.get(name, name)) for name in pair)
            if one is not None and other is not None:
                yield _to_ego(one, matches.one_px), _to_ego(other, matches.other_px)


def _to_ego(camera: Camera, points_px: Array) -> Array:
    """The directions (M, 3) in the ego frame of points (M, 2) of an image."""
    return np.asarray(pixel_rays(camera, points_px) @ camera.camera_T_ego[:3, :3], np.float64)


def _num_equal(one: Array, other: Array) -> int:
    """The number of directions (M, 3) that differ by less than the largest parallax."""
    return int((np.linalg.norm(one - other, axis=-1) < LARGEST_CHORD).sum())
