"""The judgement of the calibrations of one frame, without images, times and poses."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..runtime.frame import Camera
from .calibration import CheckedCalibration, check_calibration
from .camera_directions import COMPARED_DIRECTION, direction_findings, swapped_findings
from .camera_pairs import COMPARED_POSE, same_pose_findings
from .extrinsic_causes import shared_causes
from .extrinsics import likely_cause, pose_finding
from .findings import Finding, Verdict, worst_verdict
from .pose_plausibility import RigContext, rig_cost

CAUSED_BY_EXTRINSICS = ("pose", "direction")  # subjects of findings that a mistake in all extrinsics explains
LARGEST_RIG_COST = 2.0  # an odder rig is examined even if each pose is possible
LEAST_SHARE = 0.5  # of the cameras must have such a finding before a shared cause is looked for


@dataclass(frozen=True)
class FrameCalibration:
    """The calibrations of one frame, with their findings.

    calibrations: by camera; each with the findings about this camera by itself.
    findings: by camera; all findings, also those from comparisons with other cameras. A finding with the same cause
        for several cameras is in the list of each of them.
    """

    calibrations: Mapping[str, CheckedCalibration]
    findings: Mapping[str, tuple[Finding, ...]]

    @property
    def verdict(self) -> Verdict:
        """The most severe verdict of all cameras."""
        return worst_verdict(finding for findings in self.findings.values() for finding in findings)


def judge_calibration(cameras: Mapping[str, Camera]) -> FrameCalibration:
    """Judge the calibrations of one frame by themselves.

    cameras: by name. They may be impossible; nothing is raised.
    """
    calibrations = _check_all(cameras)
    findings = {
        name: [*calibration.findings, *direction_findings(calibration)] for name, calibration in calibrations.items()
    }
    usable = [calibration for calibration in calibrations.values() if calibration.is_usable]
    for pair in combinations(usable, 2):
        for name, finding in (*same_pose_findings(*pair), *swapped_findings(*pair)):
            findings[name].append(finding)
    findings = {name: _without_consequences(each) for name, each in findings.items()}
    cause = _shared_cause(calibrations, findings)
    if cause:
        findings = {name: _explain(calibrations[name], findings[name], cause) for name in findings}
    return FrameCalibration(calibrations, {name: tuple(each) for name, each in findings.items()})


def _check_all(cameras: Mapping[str, Camera]) -> dict[str, CheckedCalibration]:
    """Check each camera, with the other ones as context for odd poses and for the likely cause of wrong ones."""
    alone = {name: check_calibration(name, camera) for name, camera in cameras.items()}
    right = {name: each.pose for name, each in alone.items() if each.has_reliable_direction}
    return {
        name: check_calibration(name, camera, RigContext.of([pose for other, pose in right.items() if other != name]))
        for name, camera in cameras.items()
    }


def _without_consequences(findings: list[Finding]) -> list[Finding]:
    """The findings of a camera without a direction that a comparison with another camera explains."""
    is_explained = any(finding.subject.startswith((COMPARED_DIRECTION, COMPARED_POSE)) for finding in findings)
    return [finding for finding in findings if finding.subject != "direction" or not is_explained]


def _shared_cause(calibrations: Mapping[str, CheckedCalibration], findings: Mapping[str, list[Finding]]) -> str:
    """The cause that explains all extrinsics of the frame. Empty if no cause does, or if no extrinsics are wrong."""
    extrinsics = {
        name: each.camera.camera_T_ego for name, each in calibrations.items() if np.isfinite(each.pose.azimuth_deg)
    }
    rejected = [name for name in findings if any(each.subject == "camera_T_ego" for each in findings[name])]
    wrong = [name for name in findings if any(each.subject in CAUSED_BY_EXTRINSICS for each in findings[name])]
    if rejected or len(extrinsics) < max(2, len(findings)):
        return ""
    swapped = [name for name in findings if any(each.subject.startswith(COMPARED_DIRECTION) for each in findings[name])]
    if swapped and set(wrong) <= set(swapped):
        return ""
    is_odd = len(extrinsics) > 2 and rig_cost({name: calibrations[name].pose for name in extrinsics}) > LARGEST_RIG_COST
    if not is_odd and (len(wrong) < 2 or len(wrong) < LEAST_SHARE * len(findings)):
        return ""
    if not any(camera_T_ego[:3, 3].any() for camera_T_ego in extrinsics.values()):
        return ""  # the translations are missing, as the findings of the cameras say
    causes = shared_causes(extrinsics)
    return likely_cause(causes) if causes else ""


def _explain(calibration: CheckedCalibration, findings: list[Finding], cause: str) -> list[Finding]:
    """The findings of a camera with the cause that it shares with the others; at least one has this cause."""
    explained = [
        replace(each, cause=cause) if each.subject in CAUSED_BY_EXTRINSICS else each
        for each in findings
        if not each.subject.startswith((COMPARED_DIRECTION, COMPARED_POSE))  # consequences of the shared cause
    ]
    if not any(finding.cause == cause for finding in explained):
        explained.append(pose_finding(Verdict.SUSPECT, calibration.pose, cause))
    return explained
