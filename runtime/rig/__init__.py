"""Whether a rig's calibration can be right: numbers, doubts and refusals, before a network looks through it."""

from .demands import Demands
from .examination import CameraView, Examination, examine
from .findings import Finding, Verdict
from .recording import open_recording

__all__ = ["CameraView", "Demands", "Examination", "Finding", "Verdict", "examine", "open_recording"]
