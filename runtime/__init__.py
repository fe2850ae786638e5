"""Runs an exported bundle: camera frames in, detections out. Needs numpy, OpenCV and onnxruntime; never torch.

    pipeline = Pipeline.load("bundle/")
    stream = pipeline.stream()
    detections = stream.step(frame)

`pipeline.py` is the place to start reading. `bundle/` holds the contract with the exporter.
The public names are imported on first use: `runtime.errors` and other small modules then load without onnxruntime.
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
