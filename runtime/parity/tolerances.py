"""The tolerances of parity, and the failures of a comparison as lines of text."""

from typing import Any

import numpy as np

from ..bundle.manifest import Precision
from ..bundle.parity_report import QuantizedTolerances, Tolerances
from .frame_error import FrameError
from .tensor_error import TensorError

# PyTorch and onnxruntime add float32 numbers in different orders, so small errors are normal.
GRAPH_TOLERANCE = 1e-4  # largest error of a graph's output, relative to the RMS of the reference
# The same on random inputs, which amplify rounding more than frames do.
RANDOM_TOLERANCE = 3e-4
BOX_TOLERANCE = 1e-3  # largest error of a streamed box [m, rad, m/s]
SCORE_TOLERANCE = 1e-3  # largest error of a streamed score or map probability

# An int8 graph rounds every activation, so its largest error says little. What counts is the error as a whole. Maps of
# random weights are not smooth: those of `small` reach 0.05.
INT8_TOLERANCES = QuantizedTolerances(graph=0.3, dequantized=0.15, position_m=1.0, score=0.15, map=0.1)


def tolerances_for(precision: Precision) -> Tolerances:
    """Return the tolerances of a bundle, for its report."""
    return Tolerances(
        graph=GRAPH_TOLERANCE,
        random=RANDOM_TOLERANCE,
        box=BOX_TOLERANCE,
        score=SCORE_TOLERANCE,
        quantized=INT8_TOLERANCES if precision == "int8" else None,
    )


def tolerance_of(error: TensorError) -> float:
    """The largest accepted error, on a frame or on random inputs."""
    if error.quantized:
        return INT8_TOLERANCES.graph if error.seed is None else INT8_TOLERANCES.dequantized
    return GRAPH_TOLERANCE if error.seed is None else RANDOM_TOLERANCE


def size_of(error: TensorError) -> float:
    """The error that is compared with the tolerance."""
    return error.rms if error.quantized else error.relative


def describe_error(error: TensorError) -> str:
    """Describe an error outside its tolerance."""
    if np.isfinite(size_of(error)):
        kind = "RMS error" if error.quantized else "relative error"
        return f"{kind} {size_of(error):.2g} exceeds the tolerance {tolerance_of(error):g}"
    # Random inputs hold NaN in empty slots, which must have no effect.
    return "not all numbers are finite" + ("" if error.seed is None else "; empty slots held NaN")


def replace_nonfinite(value: Any) -> Any:
    """A copy of nested dicts, lists and tuples with None for NaN and infinity, which JSON does not have."""
    if isinstance(value, dict):
        return {key: replace_nonfinite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [replace_nonfinite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def stream_failures(index: int, error: FrameError, precision: Precision) -> list[str]:
    """Return what is outside the tolerances in streamed frame `index`, one line each."""
    limits = [
        ("box", error.box, BOX_TOLERANCE),
        ("score", error.score, SCORE_TOLERANCE),
        ("map", error.map, SCORE_TOLERANCE),
    ]
    if precision == "int8":
        limits = [
            ("mean position", error.mean_position_m, INT8_TOLERANCES.position_m),
            ("mean score", error.mean_score, INT8_TOLERANCES.score),
            ("mean map", error.mean_map, INT8_TOLERANCES.map),
        ]
    lines = [
        f"{quantity} error {value:.3g} exceeds the tolerance {limit:g}"
        for quantity, value, limit in limits
        if not value <= limit
    ]
    if error.unmatched:
        lines.append(f"{error.unmatched} boxes were selected by one side only")
    if error.history:
        lines.append(f"the window has {error.window + error.history} frames, expected {error.window}")
    return [f"stream, frame {index}: {line}" for line in lines]
