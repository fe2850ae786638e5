"""Checks of camera pairs: two cameras must not have the same pose or the same image."""

from collections.abc import Iterator, Mapping
from itertools import combinations

import numpy as np

from ..runtime.geometry import rotation_angle
from .calibration import CheckedCalibration
from .findings import Finding, Verdict
from .recording import CameraImage

SAME_POSITION_M = 0.01  # real cameras are farther apart than this
SAME_ROTATION_DEG = 0.5
SAME_INTRINSICS = 1e-6  # relative difference

COMPARED_POSE = "pose compared with"  # subject of a finding, before the name of the other camera
COMPARE_PICTURES = "Compare the cameras' pictures and coverage.png."


def same_pose_findings(one: CheckedCalibration, other: CheckedCalibration) -> Iterator[tuple[str, Finding]]:
    """Yield a camera name and a finding for both of two cameras, if they have the same pose.

    The calibrations must be usable.
    """
    if not _has_same_pose(one, other):
        return
    has_same_lens = np.allclose(one.camera.intrinsics_px, other.camera.intrinsics_px, rtol=SAME_INTRINSICS, atol=0)
    verdict = Verdict.BROKEN if has_same_lens else Verdict.SUSPECT
    cause = "Both names have the same calibration." if has_same_lens else "Both names may refer to the same camera."
    remedy = f"Correct camera_T_ego. {COMPARE_PICTURES}"
    for name, partner in ((one.name, other.name), (other.name, one.name)):
        subject = f"{COMPARED_POSE} {partner}"
        yield name, Finding(subject, verdict, "a different pose", f"the pose of {partner}", cause, remedy)


def same_image_findings(images: Mapping[str, CameraImage]) -> Iterator[tuple[str, Finding]]:
    """Yield a camera name and a finding for each camera that has the same image file or the same pixels as another one.

    images: of one frame, by camera.
    """
    for one, other in combinations(images, 2):
        shared = _shared_part(images[one], images[other])
        if shared is None:
            continue
        for name, partner in ((one, other), (other, one)):
            yield (
                name,
                Finding(
                    "image",
                    Verdict.BROKEN,
                    "a different image",
                    f"the same {shared} as {partner}",
                    "Two cameras cannot take the same image. One path may have the name of the other camera.",
                    f"Correct the path. {COMPARE_PICTURES}",
                ),
            )


def _has_same_pose(one: CheckedCalibration, other: CheckedCalibration) -> bool:
    if np.linalg.norm(one.pose.position_m - other.pose.position_m) > SAME_POSITION_M:
        return False
    rotation_rad = rotation_angle(one.camera.camera_T_ego[:3, :3] @ other.camera.camera_T_ego[:3, :3].T)
    return bool(np.degrees(rotation_rad) <= SAME_ROTATION_DEG)


def _shared_part(one: CameraImage, other: CameraImage) -> str | None:
    """Return "file" or "pixels" if two images share them, else None. Images of a single colour do not count.

    Cameras may have such images at night.
    """
    if one.path is not None and one.path == other.path:
        return "file"
    if one.image is None or other.image is None or np.ptp(one.image) == 0:
        return None
    return "pixels" if np.array_equal(one.image, other.image) else None
