"""The session of one graph, as the pipeline uses it, whichever engine runs the graph. Tensors are passed by name.

Tensors are onnxruntime's `OrtValue`s with every engine. They share their memory with numpy arrays, and the base
installation has them.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import onnxruntime as ort
from numpy.typing import NDArray

from .bundle.manifest import MANIFEST_NAME, TensorSpec
from .errors import ArtifactError

Tensors = dict[str, ort.OrtValue]
TensorDescription = tuple[str, tuple[int, ...], str]  # name, shape and dtype


class Session(Protocol):
    """One graph, ready to run. Several threads may run it at the same time."""

    @property
    def precision(self) -> str:
        """Number format in which float operators are computed, for example "float32"."""

    def run(self, tensors: Mapping[str, ort.OrtValue]) -> Tensors:
        """Run the graph and return its outputs by name, as new tensors.

        tensors: must contain the graph's inputs by name; other tensors are ignored. Inputs are used without a copy,
            and are not changed.

        Raises ArtifactError if the graph fails. The inputs have been validated before, so the graph is at fault.
        Raises KeyboardInterrupt if `termination.terminate_calls` ends the run.
        """


def to_tensors(**arrays: NDArray) -> Tensors:
    """Wrap arrays as tensors by name. The memory is shared, not copied."""
    return {name: ort.OrtValue.ortvalue_from_numpy(array) for name, array in arrays.items()}


def check_tensors(path: Path, side: str, actual: Sequence[TensorDescription], specified: Sequence[TensorSpec]) -> None:
    """Compare the inputs or outputs of a loaded graph with those in the manifest.

    path: the graph's file, for messages. side: "inputs" or "outputs".
    Raises ArtifactError if a name, shape or dtype differs.
    """
    expected = [(tensor.name, tensor.shape, tensor.dtype) for tensor in specified]
    for want, have in zip(expected, actual, strict=False):
        if want != have:
            raise ArtifactError(f"{path}: {side}: {MANIFEST_NAME} says {want}; the graph has {have}. Export again.")
    if len(expected) != len(actual):
        raise ArtifactError(f"{path}: {side}: {MANIFEST_NAME} lists {len(expected)}; the graph has {len(actual)}.")
