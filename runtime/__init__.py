"""How graphs serve frames: numpy, OpenCV and onnxruntime; never torch."""

from .detections import Detections
from .frame import Camera, Frame, GroundTruth
from .pipeline import Pipeline, Stream

__all__ = ["Camera", "Detections", "Frame", "GroundTruth", "Pipeline", "Stream"]
