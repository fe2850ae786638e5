"""Cameras that leave a blind sector, and would not if they looked like their counterpart on the other side."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from ..runtime.bundle.manifest import PerceptionRange
from ..runtime.bundle.preprocessing_record import Preprocessing
from ..runtime.frame import Camera
from ..runtime.geometry import inverse, rigid_transform, rotation_z
from .blind_sectors import Sector, find_blind_sectors
from .camera_names import difference_deg
from .findings import Finding, Verdict
from .formatting import describe_azimuth
from .optics import camera_pose

LARGEST_BLIND_DEG = 60.0  # in total: a rig with more lacks a camera, or is not meant to see everything
SMALLEST_YAW_DEG, LARGEST_YAW_DEG = 8.0, 45.0
LARGEST_REST = 0.3  # of the blind sectors, after the correction
MIRRORED_M = 0.4  # between a position and the mirrored one of the counterpart
CENTRAL_M = 0.2  # from the middle of the vehicle: such a camera looks straight ahead or back

COMPARE = "Correct camera_T_ego. Compare the pictures of the camera and of its counterpart, and coverage.png."


def turned_camera_findings(
    cameras: Mapping[str, Camera],
    blind_sectors: Sequence[Sector],
    perception: PerceptionRange,
    preprocessing: Preprocessing | None,
) -> Iterator[tuple[str, Finding]]:
    """Yield the camera, and a finding, whose symmetric direction would close the blind sectors of the rig.

    cameras: the usable cameras, by name.
    """
    blind_deg = _total_deg(blind_sectors)
    if not 0 < blind_deg <= LARGEST_BLIND_DEG:
        return
    rests: dict[str, tuple[float, float]] = {}  # by camera, the blind angle and the turn of the correction
    for name, camera in cameras.items():
        turn_deg = _turn_to_symmetric_deg(name, cameras)
        if turn_deg is not None and SMALLEST_YAW_DEG <= abs(turn_deg) <= LARGEST_YAW_DEG:
            turned = {**cameras, name: _turn(camera, turn_deg)}
            rests[name] = _total_deg(find_blind_sectors(turned, perception, preprocessing)), turn_deg
    if not rests:
        return
    name = min(rests, key=lambda each: rests[each][0])
    rest_deg, turn_deg = rests[name]
    if rest_deg <= LARGEST_REST * blind_deg:
        yield name, _finding(cameras[name], turn_deg, blind_deg)


def _turn_to_symmetric_deg(name: str, cameras: Mapping[str, Camera]) -> float | None:
    """How far to turn a camera to the left so that it mirrors its counterpart; None without a counterpart."""
    pose = camera_pose(cameras[name].camera_T_ego)
    mirrored = pose.position_m * (1, -1, 1)
    others = [camera_pose(camera.camera_T_ego) for other, camera in cameras.items() if other != name]
    counterparts = [other for other in others if np.linalg.norm(other.position_m - mirrored) < MIRRORED_M]
    if abs(pose.position_m[1]) < CENTRAL_M:
        expected = 0.0 if abs(pose.azimuth_deg) < 90 else 180.0
    elif len(counterparts) == 1:
        expected = -counterparts[0].azimuth_deg
    else:
        return None
    turn_deg = difference_deg(expected, pose.azimuth_deg)
    return turn_deg if (expected - pose.azimuth_deg) % 360 < 180 else -turn_deg


def _turn(camera: Camera, yaw_deg: float) -> Camera:
    ego_T_camera = inverse(camera.camera_T_ego)
    rotation = rotation_z(np.radians(yaw_deg)) @ ego_T_camera[:3, :3]
    camera_T_ego = inverse(rigid_transform(rotation, ego_T_camera[:3, 3]))
    return Camera(camera.intrinsics_px, camera_T_ego, camera.width_px, camera.height_px)


def _total_deg(sectors: Sequence[Sector]) -> float:
    return sum(sector.end_deg - sector.start_deg for sector in sectors)


def _finding(camera: Camera, turn_deg: float, blind_deg: float) -> Finding:
    azimuth_deg = camera_pose(camera.camera_T_ego).azimuth_deg
    expected_deg = (azimuth_deg + turn_deg + 180) % 360 - 180
    return Finding(
        "direction",
        Verdict.SUSPECT,
        f"{describe_azimuth(expected_deg)}, as the camera on the other side, without a blind sector",
        f"{describe_azimuth(azimuth_deg)}, with blind sectors of {blind_deg:.0f} degrees",
        f"Likely cause: the azimuth in camera_T_ego is wrong by about {abs(turn_deg):.0f} degrees.",
        COMPARE,
    )
