"""Export a model to a bundle of ONNX graphs, and compare the bundle with the model."""

from .bisection import Bisection, bisect_parity
from .bundle import ParityError, export_bundle
from .parity import ParityResult, check_parity

__all__ = ["Bisection", "ParityError", "ParityResult", "bisect_parity", "check_parity", "export_bundle"]
