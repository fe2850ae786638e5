"""Checks of a camera rig: calibrations, times, poses and images of a recording."""

from .examination import CameraView, Examination, examine
from .findings import Finding, Verdict
from .frame_calibration import FrameCalibration, judge_calibration
from .requirements import RigRequirements

__all__ = [
    "CameraView",
    "Examination",
    "Finding",
    "FrameCalibration",
    "RigRequirements",
    "Verdict",
    "examine",
    "judge_calibration",
]
