"""What can be wrong between the cameras of a rig: a calibration or picture of two, names that point elsewhere."""

import re
from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from ..frame import Camera
from .findings import Finding, Verdict
from .optics import pose, turn_deg
from .recording import Photo
from .words import describe_azimuth

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

LOOK = "Look at the cameras' pictures and at coverage.png."


def twin_findings(cameras: Mapping[str, Camera]) -> Iterator[tuple[str, Finding]]:
    """Cameras of one pose, by name; takes calibrations that the pipeline takes."""
    for one, other in combinations(cameras, 2):
        verdict = _twins(cameras[one], cameras[other])
        if verdict is None:
            continue
        for name, twin in ((one, other), (other, one)):
            cause = (
                "One calibration was given to both." if verdict is Verdict.BROKEN else "Are they one camera's pictures?"
            )
            yield (
                name,
                Finding(
                    "pose", verdict, "a pose of its own", f"that of {twin}", cause, f"Correct camera_T_ego. {LOOK}"
                ),
            )


def picture_findings(photos: Mapping[str, Photo]) -> Iterator[tuple[str, Finding]]:
    """Cameras of one picture, by name: the same file, or other files with the same pixels."""
    for one, other in combinations(photos, 2):
        how = _shared_picture(photos[one], photos[other])
        if how is None:
            continue
        for name, twin in ((one, other), (other, one)):
            got = f"{how} {twin}"
            cause = "Two cameras cannot see the same: one name stands in the other's place."
            yield (
                name,
                Finding("picture", Verdict.BROKEN, "a picture of its own", got, cause, f"Correct the path. {LOOK}"),
            )


def name_findings(name: str, camera: Camera) -> Iterator[Finding]:
    """A name that says where the camera looks, and a pose that says something else."""
    words = [word for word in re.findall(r"[a-z]+", _split_humps(name).lower()) if word in AZIMUTH_DEG]
    azimuths = np.radians([AZIMUTH_DEG[word] for word in words])
    x, y = np.cos(azimuths).sum(), np.sin(azimuths).sum()
    if np.hypot(x, y) < 0.5:
        return
    said_deg, got_deg = float(np.degrees(np.arctan2(y, x))), pose(camera.camera_T_ego).azimuth_deg
    off_deg = abs((got_deg - said_deg + 180) % 360 - 180)
    is_side = not set(words) - {"left", "right"}
    if off_deg > (LARGEST_SIDE_OFF_DEG if is_side else LARGEST_AZIMUTH_OFF_DEG):
        yield Finding(
            "direction",
            Verdict.SUSPECT,
            f"to look about {describe_azimuth(said_deg)}, as the name says",
            f"{describe_azimuth(got_deg)}",
            "Cameras are swapped, or the ego frame has other axes than x forward, y left, z up.",
            f"Correct camera_T_ego, or rename the camera. {LOOK}",
        )


def _twins(one: Camera, other: Camera) -> Verdict | None:
    apart_m = np.linalg.norm(pose(one.camera_T_ego).position_m - pose(other.camera_T_ego).position_m)
    if apart_m > SAME_PLACE_M or turn_deg(one.camera_T_ego, other.camera_T_ego) > SAME_DIRECTION_DEG:
        return None
    is_same_lens = np.allclose(one.intrinsics_px, other.intrinsics_px, rtol=SAME_LENS, atol=0)
    return Verdict.BROKEN if is_same_lens else Verdict.SUSPECT


def _shared_picture(one: Photo, other: Photo) -> str | None:
    if one.path is not None and one.path == other.path:
        return "the file of"
    if one.image is None or other.image is None or np.ptp(one.image) == 0:
        return None
    return "the pixels of" if np.array_equal(one.image, other.image) else None


def _split_humps(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
