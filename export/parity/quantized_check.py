"""The parity check of a new int8 bundle against the float32 bundle that it was made from."""

from collections.abc import Collection
from pathlib import Path

import torch

from ...model import DuoSpaceNetConfig
from ...runtime import Pipeline
from ...runtime.bundle.manifest import MANIFEST_NAME, sha256
from ...runtime.progress import Progress, no_progress
from ...weights.input_contract import temporal_window
from .bundle_reference import BundleReference
from .comparison import Comparison
from .parity_result import ParityResult
from .sequence_coverage import Coverage
from .stress_sequence import stress_sequence


@torch.no_grad()
def check_quantized(
    bundle: Path,
    float_bundle: Path,
    config: DuoSpaceNetConfig,
    quantized: Collection[str],
    progress: Progress = no_progress,
) -> ParityResult:
    """Compare an int8 bundle with its float32 bundle on the stress sequence, graph by graph and as a stream.

    config: the configuration of both. quantized: the names of the quantized graphs.

    Only `check_parity` compares an int8 bundle with its weights, because it has the model.
    """
    # The int8 bundle gets its parity report from this check, so it has none yet.
    pipeline = Pipeline.load(bundle, require_parity=False)
    reference = BundleReference(Pipeline.load(float_bundle), config)
    frames, comparison = stress_sequence(config), Comparison(pipeline, reference, quantized)
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
        precision="int8",
        reference=f"the float32 bundle with {MANIFEST_NAME} {sha256(float_bundle / MANIFEST_NAME)[:12]}",
    )
