"""The parity check of a new int8 bundle against the float32 bundle that it was made from."""

from pathlib import Path

import torch

from ...runtime import Pipeline
from ...runtime.progress import Progress, no_progress
from ...weights.input_contract import temporal_window
from .bundle_reference import BundleReference
from .comparison import Comparison
from .parity_result import ParityResult
from .quantized_graphs import QuantizedGraphs
from .sequence_coverage import Coverage
from .stress_sequence import stress_sequence


@torch.no_grad()
def check_quantized(
    bundle: Path,
    pipeline: Pipeline,
    reference: BundleReference,
    reference_name: str,
    progress: Progress = no_progress,
) -> ParityResult:
    """Compare an int8 bundle with its float32 bundle on the stress sequence, graph by graph and as a stream.

    bundle: the int8 bundle. pipeline: it, loaded.
    reference: the float32 bundle. reference_name: its name, for the report.

    Only `check_parity` compares an int8 bundle with its weights, because it has the model.
    """
    graphs = QuantizedGraphs.read(bundle, pipeline.manifest)
    comparison, config = Comparison(pipeline, reference, graphs.sessions), reference.config
    frames = stress_sequence(config)
    windows = comparison.add_sequence(frames, 0, progress, "stress sequence")
    coverage = Coverage.of(frames, windows, config, temporal_window(config))
    return ParityResult(
        source="stress sequence",
        frames=len(frames),
        graphs=comparison.graph_errors,
        stream=comparison.stream_errors,
        coverage=coverage,
        shortfalls=coverage.shortfalls(config),
        random_inputs={},
        scales=comparison.scales,
        liveness={},
        manifest=[],
        weights=None,
        precision=graphs.precision,
        quantization=(*graphs.failures(pipeline.manifest), *comparison.scale_failures()),
        reference=reference_name,
    )
