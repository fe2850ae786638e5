"""Writes the golden example of a bundle: a few frames, and what PyTorch in eager mode computes from them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..data.results import FrameResult, frame_result
from ..data.scene_writer import write_scene
from ..model import DuoSpaceNet
from ..runtime import Frame
from ..runtime.bundle.golden_files import hash_golden_files, write_expected_values
from ..runtime.bundle.golden_record import (
    GOLDEN_RESULTS,
    GOLDEN_SCENE,
    INPUTS,
    MAPS,
    ExpectedFrame,
    ExpectedTensor,
    ExpectedValues,
    GoldenRecord,
    ResultTolerance,
)
from ..runtime.detections import HistoryReport
from ..runtime.files import write_atomically
from ..runtime.golden_sampling import rms, sample
from ..weights.input_contract import temporal_window
from .golden_scene import golden_scene
from .parity.comparison import arrays
from .parity.eager_stream import detections_of
from .parity.expected_windows import expected_windows
from .parity.reference import EagerReference, GraphRun

# The consumer computes the frames one after the other from its own cached values, so errors add up. The tolerances are
# more than ten times the errors of OpenVINO in float32 with the trained nano, and far below those of a wrong tensor.
RELATIVE_TOLERANCE = 1e-3  # of an output, relative to its RMS
INPUT_TOLERANCE = 1e-5  # of a float input, relative to its largest number
BOX_TOLERANCE = 5e-3  # of a box number [m, rad, m/s]
SCORE_TOLERANCE = 1e-3  # of a score or map probability


@torch.no_grad()
def write_golden_example(bundle: Path, model: DuoSpaceNet) -> GoldenRecord:
    """Write the golden example of `model` to the folder of a bundle. Returns its entry in the manifest."""
    frames = golden_scene(model.config)
    expected, results = _run(model, frames)
    write_scene(bundle / GOLDEN_SCENE, frames)
    write_expected_values(bundle, expected)
    write_atomically(bundle / GOLDEN_RESULTS, "".join(json.dumps(line) + "\n" for line in results).encode())
    return hash_golden_files(bundle)


def _run(model: DuoSpaceNet, frames: Sequence[Frame]) -> tuple[ExpectedValues, list[FrameResult]]:
    """The expected values and the result lines of the frames, from eager mode."""
    reference = EagerReference(model)
    expected, results = [], []
    for window in expected_windows(frames, temporal_window(model.config)):
        frame = frames[window[0]]
        runs = reference.step(frames, window)
        ages_s = tuple(frame.timestamp_s - frames[index].timestamp_s for index in window[1:])
        detections = detections_of(model.config, frame, runs, HistoryReport(len(window), None, ages_s))
        maps = {f"{MAPS}.{name}": sample(name, mask, SCORE_TOLERANCE) for name, mask in detections.maps.items()}
        expected.append(ExpectedFrame(token=frame.token, tensors=_sampled(runs) | maps))
        results.append(frame_result(frame, detections, {}))
    tolerance = ResultTolerance(box=BOX_TOLERANCE, score=SCORE_TOLERANCE)
    return ExpectedValues(schema_version=1, tolerance=tolerance, frames=tuple(expected)), results


def _sampled(runs: Mapping[str, GraphRun]) -> dict[str, ExpectedTensor]:
    """The sampled inputs of the host and outputs of the graphs, by name."""
    produced = {name for run in runs.values() for name in run.outputs}
    inputs: dict[str, Tensor] = {}
    for run in runs.values():  # the decoder runs last, so its inputs take precedence
        inputs |= {name: value for name, value in run.inputs.items() if name not in produced and "." not in name}
    tensors = {}
    for name, array in arrays(inputs).items():
        tensors[f"{INPUTS}.{name}"] = sample(f"{INPUTS}.{name}", array, _input_tolerance(array))
    valid = arrays(inputs)["camera_valid"]
    lost = ~(valid[0] if valid.ndim == 2 else valid)
    for graph, run in runs.items():
        for name, array in arrays(run.outputs).items():
            # A consumer may leave out the images of lost cameras.
            undefined = lost.reshape(-1, *(1,) * (array.ndim - 1)) if graph == "backbone" else None
            tensors[f"{graph}.{name}"] = sample(f"{graph}.{name}", array, _output_tolerance(name, array), undefined)
    return tensors


def _input_tolerance(value: NDArray) -> float:
    return INPUT_TOLERANCE * float(np.abs(value).max()) if value.dtype == np.float32 else 0.0


def _output_tolerance(name: str, value: NDArray) -> float:
    if name == "boxes":
        return BOX_TOLERANCE
    return RELATIVE_TOLERANCE * rms(value) if value.dtype == np.float32 else 0.0
