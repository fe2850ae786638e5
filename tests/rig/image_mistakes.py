"""Mistakes that the images show: turned cameras, and exchanged, repeated and lost images."""

from collections.abc import Callable

import numpy as np

from duospacenet.runtime.geometry import (
    inverse,
    rigid_transform,
    rotation_z,
)
from tests.rig.scene_mistake import Injection, Mistake, Record, Rng, calibrations_of, random_pair


def _yaw_one(record: Record, rng: Rng) -> list[str]:
    yaw = np.radians(rng.uniform(17, 28) * rng.choice([-1, 1]))
    calibrations = calibrations_of(record)
    level = [name for name in sorted(calibrations) if "tele" not in name]
    name = str(rng.choice(level))
    for camera in calibrations[name]:
        ego_T_camera = inverse(np.array(camera["camera_T_ego"]))
        rotation = rotation_z(yaw) @ ego_T_camera[:3, :3]
        camera["camera_T_ego"] = inverse(rigid_transform(rotation, ego_T_camera[:3, 3])).tolist()
    return [name]


def _exchange_images(pair: Callable[[Record, Rng], tuple[str, str]]) -> Injection:
    def inject(record: Record, rng: Rng) -> list[str]:
        one, other = pair(record, rng)
        for frame in record["frames"]:
            cameras = frame["cameras"]
            cameras[one]["image"], cameras[other]["image"] = cameras[other]["image"], cameras[one]["image"]
        return [one, other]

    return inject


def _mirrored_pair(record: Record, rng: Rng) -> tuple[str, str]:
    """A camera with its counterpart on the other side."""
    azimuths = {}
    for name, cameras in calibrations_of(record).items():
        axis = np.array(cameras[0]["camera_T_ego"])[2]
        azimuths[name] = np.degrees(np.arctan2(axis[1], axis[0]))
    side = [name for name in sorted(azimuths) if 30 < azimuths[name] < 150]
    one = str(rng.choice(side))
    return one, min(azimuths, key=lambda name: abs(azimuths[name] + azimuths[one]))


def _freeze(one: bool) -> Injection:
    def inject(record: Record, rng: Rng) -> list[str]:
        frames = record["frames"]
        names = [str(rng.choice(sorted(frames[0]["cameras"])))] if one else list(frames[0]["cameras"])
        for frame in frames:
            for name in names:
                frame["cameras"][name]["image"] = frames[0]["cameras"][name]["image"]
        return names

    return inject


def _twin(record: Record, rng: Rng) -> list[str]:
    one, other = random_pair(record, rng)
    for frame in record["frames"]:
        frame["cameras"][one]["image"] = frame["cameras"][other]["image"]
    return [one, other]


def _lose(record: Record, rng: Rng) -> list[str]:
    name = str(rng.choice(sorted(record["frames"][0]["cameras"])))
    for frame in record["frames"]:
        frame["cameras"][name]["image"] = None
    return [name]


IMAGE_MISTAKES: dict[str, Mistake] = {
    "one camera yawed": Mistake(_yaw_one, "azimuth in camera_T_ego is wrong", compares_images=True),
    "left and right images exchanged": Mistake(
        _exchange_images(_mirrored_pair), "images of this camera and of .* are exchanged", compares_images=True
    ),
    "two images exchanged": Mistake(
        _exchange_images(random_pair), "images of this camera and of .* are exchanged", compares_images=True
    ),
    "one camera frozen": Mistake(_freeze(True), "camera is frozen", compares_images=True),
    "all cameras frozen": Mistake(_freeze(False), "same images were given again", "drive", compares_images=True),
    "one image twice": Mistake(_twin, "cannot take the same image|given under both names", compares_images=True),
    "one camera lost": Mistake(_lose, "lost throughout"),
}
