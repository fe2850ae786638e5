"""The calibration of a quantization, and the sensitivity of each block: runs of a float32 bundle over clips."""

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..export.quantization.blocks import OPERATORS
from ..export.quantization.calibration import GraphCalibration, calibrating_pipeline
from ..export.quantization.candidate import Block, Candidates
from ..export.quantization.sensitivity import Outputs, Sensitivity
from ..runtime import Pipeline
from ..runtime.errors import InputError
from ..runtime.progress import Progress, no_progress
from ..runtime.recording_session import recording_pipeline
from .quantization_frames import Clip
from .quantization_judge import run_clips


def calibrate(
    bundle: Path, pipeline: Pipeline, clips: Sequence[Clip], folder: Path, progress: Progress = no_progress
) -> Candidates:
    """Measure the ranges of the float32 graphs' tensors on the inputs that they get in streams, and on black images.

    bundle: the float32 bundle. pipeline: it, loaded.
    folder: an existing folder for temporary files, which are removed.
    Raises InputError if no frame has an image.
    """
    graphs = pipeline.manifest.graphs
    with tempfile.TemporaryDirectory(dir=folder) as temporary:
        calibrations = {
            name: GraphCalibration(bundle / graphs[name].file, Path(temporary), operators)
            for name, operators in OPERATORS.items()
            if name in graphs
        }
        runs = run_clips(calibrating_pipeline(pipeline, calibrations), clips, progress, "calibration")
        num_processed = sum(detections.skipped is None for _, detections in runs)
        if not num_processed:
            raise InputError("--source: expected a frame with an image among those of the calibration; got none.")
        # A lost camera has a black image, which can be darker than every image of these frames.
        calibrations["backbone"].add(
            {spec.name: np.zeros(spec.shape, spec.dtype) for spec in graphs["backbone"].inputs}
        )
        ranges = {name: calibration.ranges() for name, calibration in calibrations.items()}
    return Candidates(bundle, pipeline, ranges)


def measure_sensitivities(
    pipeline: Pipeline,
    candidates: Candidates,
    blocks: Sequence[Block],
    clips: Sequence[Clip],
    progress: Progress = no_progress,
) -> list[Sensitivity]:
    """Quantize each block alone, and compare the outputs with those of the float32 bundle. Most sensitive first.

    Raises InputError if no frame has an image.
    """
    reference = _outputs(pipeline, clips)
    if not reference:
        raise InputError("--source: expected images in one of the first frames; got none. Begin at a later frame.")
    rows = [
        Sensitivity.between(block, reference, _outputs(candidates.engine_pipeline(candidates.quantize([block])), clips))
        for block in progress(blocks, "sensitivity")
    ]
    return sorted(rows, key=lambda row: row.error, reverse=True)


def _outputs(pipeline: Pipeline, clips: Sequence[Clip]) -> list[Outputs]:
    """The outputs of the decoder and the segmenter for each frame."""
    pipeline, recordings = recording_pipeline(pipeline)
    names = [name for name in ("decoder", "segmenter") if name in recordings]
    outputs: list[Outputs] = []
    for _, detections in run_clips(pipeline, clips, no_progress, ""):
        if detections.skipped is None:
            outputs.append({key: value.copy() for name in names for key, value in recordings[name].outputs.items()})
    return outputs
