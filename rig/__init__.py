"""Whether a rig's calibration can be right: numbers, doubts and refusals, before a network looks through it."""

from .examination import CameraView, Examination, examine
from .findings import Finding, Verdict
from .requirements import RigRequirements

__all__ = ["CameraView", "Examination", "Finding", "RigRequirements", "Verdict", "examine"]
