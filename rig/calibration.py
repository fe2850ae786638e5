"""Checks of one camera: its calibration by itself, and its image against the calibration.

A calibration that `runtime/validation.py` rejects is broken. A valid calibration is broken only if it is impossible for
a camera on a vehicle. Unusual values are suspect, because some rigs are built that way.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..runtime.errors import InputError
from ..runtime.frame import Camera
from ..runtime.validation import check_camera
from .extrinsics import CORRECT_EXTRINSICS, extrinsics_findings, invalid_extrinsics_cause
from .findings import Finding, Verdict, finding_from_error, worst_verdict
from .intrinsics import CORRECT_INTRINSICS, intrinsics_findings, invalid_intrinsics_cause
from .optics import CameraPose, camera_pose
from .pose_plausibility import RigContext
from .recording import CameraImage

SAME_ASPECT = 0.02  # aspect ratios with a smaller relative difference count as equal


@dataclass(frozen=True, eq=False)
class CheckedCalibration:
    """One camera's calibration, its pose, and the findings from the calibration alone."""

    name: str
    camera: Camera
    pose: CameraPose
    findings: tuple[Finding, ...]

    @property
    def is_usable(self) -> bool:
        """Whether the calibration is not broken, so that points can be projected with it."""
        return worst_verdict(self.findings) is not Verdict.BROKEN

    @property
    def has_reliable_direction(self) -> bool:
        """Whether the viewing direction may be compared with the camera's name: not if the pose has a finding."""
        return self.is_usable and all(finding.subject != "pose" for finding in self.findings)


def check_calibration(name: str, camera: Camera, context: RigContext | None = None) -> CheckedCalibration:
    """Check the calibration of one camera. context: of the other cameras of the rig, for the likely cause."""
    pose = camera_pose(camera.camera_T_ego)
    return CheckedCalibration(name, camera, pose, tuple(_findings(name, camera, pose, context)))


def calibration_bytes(camera: Camera) -> bytes:
    """The exact numbers of a calibration, as a key. Equal calibrations have equal bytes."""
    matrices = (np.ascontiguousarray(each, np.float64) for each in (camera.intrinsics_px, camera.camera_T_ego))
    return b"".join((f"{camera.width_px}x{camera.height_px} ".encode(), *(each.tobytes() for each in matrices)))


def image_findings(image: CameraImage, camera: Camera) -> list[Finding]:
    """Findings about a camera's image: it cannot be read, or its size differs from the calibration."""
    if image.error is None:
        return []
    cause = _wrong_size_cause(image.size_px, (camera.width_px, camera.height_px))
    return [finding_from_error("image", image.error, cause)]


def _findings(name: str, camera: Camera, pose: CameraPose, context: RigContext | None) -> Iterator[Finding]:
    try:
        check_camera(name, camera)
    except InputError as error:
        yield _invalid_calibration(camera, error)
        return
    yield from intrinsics_findings(camera)
    yield from extrinsics_findings(camera, pose, name, context)


def _invalid_calibration(camera: Camera, error: InputError) -> Finding:
    if ": camera_T_ego" in str(error):
        cause = invalid_extrinsics_cause(camera.camera_T_ego)
        return finding_from_error("camera_T_ego", error, cause, CORRECT_EXTRINSICS)
    return finding_from_error("intrinsics_px", error, invalid_intrinsics_cause(camera), CORRECT_INTRINSICS)


def _wrong_size_cause(size_px: tuple[int, int] | None, expected_px: tuple[int, int]) -> str:
    """The likely cause of an image size that differs from the calibration; empty if it is equal or unknown."""
    if size_px is None or size_px == expected_px:
        return ""
    if size_px == expected_px[::-1]:
        return "Width and height are swapped, or the image was rotated after the calibration."
    ratio = size_px[0] / expected_px[0]
    if abs(size_px[1] / expected_px[1] / ratio - 1) < SAME_ASPECT:
        return f"The image was scaled by {ratio:.4g} after the calibration. The intrinsics must be scaled with it."
    return "The image was cropped after the calibration, or it belongs to another camera."
