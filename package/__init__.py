"""DuoSpaceNet, exported to ONNX, run on a CPU by onnxruntime, and proven equal to the model it came from."""

__version__ = "0.2.0"
