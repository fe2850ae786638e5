"""A mistake that can be made in the scene.json of a scene folder."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Array = np.ndarray
Record = dict[str, Any]
Rng = np.random.Generator
Injection = Callable[[Record, Rng], list[str]]  # changes a scene, and returns the names of the wrong cameras


@dataclass(frozen=True)
class Mistake:
    """inject: makes the mistake. cause: words of the right cause, alternatives separated by `|`.

    part: of the report that must name the cause: "cameras", "drive" or "ground_truth".
    compares_images: whether only the images show the mistake.
    """

    inject: Injection
    cause: str
    part: str = "cameras"
    compares_images: bool = False


def calibrations_of(record: Record) -> dict[str, list[Record]]:
    """All records with a calibration, by camera: that of the scene, or those of the frames."""
    found: dict[str, list[Record]] = {}
    for cameras in (record.get("cameras", {}), *(frame["cameras"] for frame in record["frames"])):
        for name, camera in cameras.items():
            if "camera_T_ego" in camera:
                found.setdefault(name, []).append(camera)
    return found


def random_pair(record: Record, rng: Rng) -> tuple[str, str]:
    """Two cameras that look in different directions."""
    names = sorted(name for name in record["frames"][0]["cameras"] if "tele" not in name)
    one, other = rng.choice(names, 2, replace=False)
    return str(one), str(other)
