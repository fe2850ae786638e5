"""Versions of the libraries in use, read from the modules themselves.

The names of distributions cannot be relied on: `cv2` comes from opencv-python, opencv-python-headless and others, and
`onnxruntime` from onnxruntime-gpu, onnxruntime-openvino and others.
"""

from collections.abc import Iterable
from importlib import import_module

MODULES = {"opencv": "cv2", "onnx-ir": "onnx_ir"}  # libraries with another name than their module


def library_versions(names: Iterable[str]) -> dict[str, str]:
    """The version of each library by name; "unknown" for a module without `__version__`."""
    return {name: str(getattr(import_module(MODULES.get(name, name)), "__version__", "unknown")) for name in names}
