"""DuoSpaceNet, exported to ONNX, run on a CPU by onnxruntime, and proven equal to the model it came from."""

from duospacenet.runtime.telemetry import disable_telemetry

__version__ = "0.2.0"

disable_telemetry()  # here, because every import of the toolkit runs this module before one that imports onnxruntime
