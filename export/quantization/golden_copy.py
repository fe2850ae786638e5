"""The golden example of an int8 bundle: that of its float32 bundle, with tolerances for the rounding."""

import shutil
from collections.abc import Collection
from pathlib import Path

import numpy as np

from ...runtime.bundle.golden_files import (
    check_golden_files,
    hash_golden_files,
    read_expected_values,
    write_expected_values,
)
from ...runtime.bundle.golden_record import (
    GOLDEN_FOLDER,
    MAPS,
    ExpectedFrame,
    ExpectedTensor,
    GoldenRecord,
    ResultTolerance,
)
from ...runtime.bundle.manifest import GraphName, Manifest
from ...runtime.golden_sampling import rms

# Relative to the RMS of eager mode's values. The trained nano has at most 0.18, and tiny with random weights 0.32,
# since the errors of several graphs add up; parity accepts 0.3 of each graph. Engines round differently: in the same
# int8 graphs, another arithmetic changes the features by up to 0.1. A wrong tensor has about 1.4.
RELATIVE_TOLERANCE = 0.5


def copy_golden_example(
    bundle: Path, manifest: Manifest, quantized: Collection[GraphName], folder: Path
) -> GoldenRecord | None:
    """Copy the golden example of a float32 bundle to the folder of an int8 bundle.

    The expected values stay those of eager mode. Outputs of quantized graphs, and of graphs that read them, are
    compared by their RMS error, and boxes and scores of the results are not compared.

    bundle, manifest: the float32 bundle. quantized: names of the quantized graphs.
    Returns the entry in the manifest; None if the float32 bundle has no golden example. Raises ArtifactError if its
    files are damaged.
    """
    if manifest.golden is None:
        return None
    check_golden_files(bundle, manifest)
    expected = read_expected_values(bundle, manifest.golden)
    shutil.copytree(bundle / GOLDEN_FOLDER, folder / GOLDEN_FOLDER)
    rounded = _rounded_graphs(manifest, quantized)
    frames = tuple(_with_tolerances(frame, rounded) for frame in expected.frames)
    tolerance = ResultTolerance(box=None, score=None) if "decoder" in rounded else expected.tolerance
    write_expected_values(folder, expected.model_copy(update={"frames": frames, "tolerance": tolerance}))
    return hash_golden_files(folder)


def _rounded_graphs(manifest: Manifest, quantized: Collection[GraphName]) -> set[str]:
    """The graphs that are quantized, or that read an output of such a graph."""
    rounded: set[str] = set(quantized)
    tensors: set[str] = set()
    for name, graph in manifest.graphs.items():
        if name in rounded or any(tensor.name.rpartition(".")[2] in tensors for tensor in graph.inputs):
            rounded.add(name)
            tensors |= {tensor.name for tensor in graph.outputs}
    return rounded | {MAPS} if "segmenter" in rounded else rounded


def _with_tolerances(frame: ExpectedFrame, rounded: Collection[str]) -> ExpectedFrame:
    tensors = {
        name: _with_tolerance(tensor) if name.partition(".")[0] in rounded else tensor
        for name, tensor in frame.tensors.items()
    }
    return frame.model_copy(update={"tensors": tensors})


def _with_tolerance(tensor: ExpectedTensor) -> ExpectedTensor:
    values = np.array([value for value in tensor.values if value is not None], np.float64)
    tolerance = float(f"{RELATIVE_TOLERANCE * rms(values):.3g}")
    return tensor.model_copy(update={"compare": "rms", "tolerance": tolerance})
