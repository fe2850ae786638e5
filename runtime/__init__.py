"""Runs an exported bundle: camera frames in, detections out. Needs numpy, OpenCV and onnxruntime; never torch.

    pipeline = Pipeline.load("bundle/")
    stream = pipeline.stream()
    detections = stream.step(frame)

Start reading in `pipeline.py`. `bundle/` defines the bundle format, which export writes and the runtime reads.
The public names are imported on first use, so that small modules such as `runtime.errors` load without onnxruntime.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .detections import Detections
    from .frame import Camera, Frame, GroundTruth
    from .pipeline import Pipeline, Stream
else:
    _MODULES = {
        "Camera": "frame",
        "Detections": "detections",
        "Frame": "frame",
        "GroundTruth": "frame",
        "Pipeline": "pipeline",
        "Stream": "pipeline",
    }

    def __getattr__(name):
        if name not in _MODULES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(import_module(f".{_MODULES[name]}", __name__), name)


__all__ = ["Camera", "Detections", "Frame", "GroundTruth", "Pipeline", "Stream"]
