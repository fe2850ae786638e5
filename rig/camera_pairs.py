"""What can be wrong between the cameras of a rig: a calibration or picture of two, names that point elsewhere."""

import re
from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from ..runtime.geometry import rotation_angle
from .calibration import Calibration
from .findings import Finding, Verdict
from .formatting import describe_azimuth
from .recording import CameraImage

SAME_PLACE_M = 0.01  # two cameras need more room than this
SAME_DIRECTION_DEG = 0.5
SAME_LENS = 1e-6

AZIMUTH_DEG = {
    **dict.fromkeys(("front", "forward", "ahead"), 0.0),
    **dict.fromkeys(("back", "rear", "backward"), 180.0),
    "left": 90.0,
    "right": -90.0,
}
LARGEST_AZIMUTH_OFF_DEG = 75.0  # of what a name with front or back in it says
LARGEST_SIDE_OFF_DEG = 100.0  # of what left or right alone says: both cameras of a stereo pair look ahead
LEAST_EXCHANGED_DEG = 40.0  # by which two cameras, taken for each other, are nearer to their names in sum

LOOK = "Look at the cameras' pictures and at coverage.png."


def twin_findings(one: Calibration, other: Calibration) -> Iterator[tuple[str, Finding]]:
    """Two cameras of one pose, by name; takes calibrations that the pipeline takes."""
    verdict = _twins(one, other)
    if verdict is None:
        return
    cause = "One calibration was given to both." if verdict is Verdict.BROKEN else "Are they one camera's pictures?"
    remedy = f"Correct camera_T_ego. {LOOK}"
    for name, twin in ((one.name, other.name), (other.name, one.name)):
        yield name, Finding(f"pose beside {twin}", verdict, "one of its own", f"that of {twin}", cause, remedy)


def exchange_findings(one: Calibration, other: Calibration) -> Iterator[tuple[str, Finding]]:
    """Two cameras each of which looks where the other's name says, by name."""
    one_deg, other_deg = said_azimuth(one.name), said_azimuth(other.name)
    names = f"{one.name} {other.name}".lower()
    if one_deg is None or other_deg is None or "mirror" in names or not (one.has_direction and other.has_direction):
        return  # a camera in a mirror is named after where it sits
    got = one.where.azimuth_deg, other.where.azimuth_deg
    nearer_deg = [
        _apart_deg(one_deg, got[0]) - _apart_deg(one_deg, got[1]),
        _apart_deg(other_deg, got[1]) - _apart_deg(other_deg, got[0]),
    ]
    if min(nearer_deg) <= 0 or sum(nearer_deg) <= LEAST_EXCHANGED_DEG:
        return
    for name, twin, azimuth_deg in ((one.name, other.name, got[0]), (other.name, one.name, got[1])):
        yield (
            name,
            Finding(
                f"direction beside {twin}",
                Verdict.SUSPECT,
                "the one that the name says",
                f"{describe_azimuth(azimuth_deg)}, nearer to the name of {twin}, which looks nearer to that of {name}",
                "The two cameras were exchanged.",
                f"Exchange the calibrations, or the pictures, of the two. {LOOK}",
            ),
        )


def picture_findings(camera_images: Mapping[str, CameraImage]) -> Iterator[tuple[str, Finding]]:
    """Cameras of one picture, by name: the same file, or other files with the same pixels."""
    for one, other in combinations(camera_images, 2):
        how = _shared_picture(camera_images[one], camera_images[other])
        if how is None:
            continue
        for name, twin in ((one, other), (other, one)):
            got = f"{how} {twin}"
            cause = "Two cameras cannot see the same: one name stands in the other's place."
            yield (
                name,
                Finding("picture", Verdict.BROKEN, "a picture of its own", got, cause, f"Correct the path. {LOOK}"),
            )


def name_findings(calibration: Calibration) -> Iterator[Finding]:
    """A name that says where the camera looks, and a pose that says something else."""
    said_deg = said_azimuth(calibration.name)
    if said_deg is None or not calibration.has_direction:
        return
    got_deg = calibration.where.azimuth_deg
    is_side = not set(_telling_words(calibration.name)) - {"left", "right"}
    if _apart_deg(said_deg, got_deg) > (LARGEST_SIDE_OFF_DEG if is_side else LARGEST_AZIMUTH_OFF_DEG):
        yield Finding(
            "direction",
            Verdict.SUSPECT,
            f"to look about {describe_azimuth(said_deg)}, as the name says",
            f"{describe_azimuth(got_deg)}",
            "Cameras are swapped, or the ego frame has other axes than x forward, y left, z up.",
            f"Correct camera_T_ego, or rename the camera. {LOOK}",
        )


def said_azimuth(name: str) -> float | None:
    """Where a camera of this name should look [deg], or None where the name does not say."""
    azimuths = np.radians([AZIMUTH_DEG[word] for word in _telling_words(name)])
    x, y = np.cos(azimuths).sum(), np.sin(azimuths).sum()
    return float(np.degrees(np.arctan2(y, x))) if np.hypot(x, y) >= 0.5 else None


def _telling_words(name: str) -> list[str]:
    with_spaces = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
    return [word for word in re.findall(r"[a-z]+", with_spaces.lower()) if word in AZIMUTH_DEG]


def _apart_deg(one_deg: float, other_deg: float) -> float:
    return abs((one_deg - other_deg + 180) % 360 - 180)


def _twins(one: Calibration, other: Calibration) -> Verdict | None:
    if np.linalg.norm(one.where.position_m - other.where.position_m) > SAME_PLACE_M:
        return None
    turn_rad = rotation_angle(one.camera.camera_T_ego[:3, :3] @ other.camera.camera_T_ego[:3, :3].T)
    if np.degrees(turn_rad) > SAME_DIRECTION_DEG:
        return None
    is_same_lens = np.allclose(one.camera.intrinsics_px, other.camera.intrinsics_px, rtol=SAME_LENS, atol=0)
    return Verdict.BROKEN if is_same_lens else Verdict.SUSPECT


def _shared_picture(one: CameraImage, other: CameraImage) -> str | None:
    if one.path is not None and one.path == other.path:
        return "the file of"
    if one.image is None or other.image is None or np.ptp(one.image) == 0:
        return None
    return "the pixels of" if np.array_equal(one.image, other.image) else None
