"""The result of a parity check: measured errors, tolerances, and the failures as lines of text."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ...runtime.bundle.manifest import Precision
from ...runtime.bundle.parity_report import ParityReport, QuantizedTolerances, WeightMatchRecord
from .frame_error import FrameError
from .liveness import Liveness
from .manifest_differences import FieldDifference
from .retraced_graphs import Retrace
from .sequence_coverage import Coverage
from .tensor_error import TensorError
from .weight_match import WeightMatch

# PyTorch and onnxruntime add float32 numbers in different orders, so small errors are normal.
GRAPH_TOLERANCE = 1e-4  # largest error of a graph's output, relative to the RMS of the reference
# The same on random inputs, which amplify rounding more than frames do: the trained nano reaches 8e-5.
RANDOM_TOLERANCE = 3e-4
BOX_TOLERANCE = 1e-3  # largest error of a streamed box [m, rad, m/s]
SCORE_TOLERANCE = 1e-3  # largest error of a streamed score or map probability

# An int8 graph rounds every activation, so its largest error says little. What counts is the error as a whole. Maps of
# random weights are not smooth: those of `small` reach 0.05.
INT8_TOLERANCES = QuantizedTolerances(graph=0.3, dequantized=0.15, position_m=1.0, score=0.15, map=0.1)


@dataclass(frozen=True)
class ParityResult:
    """Everything that `check_parity` compared.

    source: name of the frames. frames: their number.
    graphs: the largest error by graph and output, on frames and on random inputs. The inputs were eager mode's.
    stream: the error of each frame. The pipeline ran as a stream, on its own cached values.
    coverage: what the stress sequence exercises. shortfalls: what it lacks, one line each.
    random_inputs: number of random inputs by graph.
    scales: RMS of each float tensor of a frame, by name; with a seed they give the random inputs again.
    liveness: the elements that were disturbed, by graph.
    manifest: fields that differ from those of the model's configuration and weights.
    weights: the comparison of the constants in the graphs with the model's weights; None if it was not requested.
    retrace: the comparison with a new export; None if it was not requested.
    precision: of the bundle; it decides the tolerances.
    quantization: what is wrong with the scales of quantized graphs, one line each.
    reference: what the bundle was compared with; None for eager PyTorch.
    """

    source: str
    frames: int
    graphs: dict[str, dict[str, TensorError]]
    stream: list[FrameError]
    coverage: Coverage
    shortfalls: list[str]
    random_inputs: dict[str, int]
    scales: dict[str, float]
    liveness: dict[str, Liveness]
    manifest: list[FieldDifference]
    weights: WeightMatch | None
    retrace: Retrace | None = None
    precision: Precision = "float32"
    quantization: tuple[str, ...] = ()
    reference: str | None = None

    @property
    def failing_outputs(self) -> list[tuple[str, str, TensorError]]:
        """Graph outputs outside the tolerance, as (graph, output, error)."""
        return [
            (graph, name, error)
            for graph, outputs in self.graphs.items()
            for name, error in outputs.items()
            # `not <=` instead of `>`, so that a NaN fails.
            if not size_of(error) <= tolerance_of(error)
        ]

    @property
    def failing_frames(self) -> list[int]:
        """Indices of the streamed frames outside the tolerances."""
        return [index for index, error in enumerate(self.stream) if _stream_failures(index, error, self.precision)]

    @property
    def failures(self) -> list[str]:
        """All violations, one line each."""
        return [
            *(f"{graph}.{name}, {error.case}: {_describe(error)}" for graph, name, error in self.failing_outputs),
            *(
                line
                for index, error in enumerate(self.stream)
                for line in _stream_failures(index, error, self.precision)
            ),
            *(f"{name}: disturbed by itself, it changes the outputs differently" for name in self.wrong_elements),
            *(self.weights.failures if self.weights else ()),
            *self.quantization,
            *(self.retrace.differences if self.retrace else ()),
            *map(str, self.manifest),
            *self.shortfalls,
        ]

    @property
    def wrong_elements(self) -> list[str]:
        """Elements of inputs that change the outputs differently in the bundle, as `graph.input[place]`."""
        return [name for liveness in self.liveness.values() for name in liveness.wrong]

    @property
    def passed(self) -> bool:
        """Whether there is no violation."""
        return not self.failures

    def to_report(self) -> ParityReport:
        """The report for the manifest. Numbers that are not finite become None."""
        weights = self.weights
        report = {
            "reference": self.reference,
            "passed": self.passed,
            "failures": self.failures,
            "tolerances": {
                "graph": GRAPH_TOLERANCE,
                "random": RANDOM_TOLERANCE,
                "box": BOX_TOLERANCE,
                "score": SCORE_TOLERANCE,
                "quantized": INT8_TOLERANCES if self.precision == "int8" else None,
            },
            "source": self.source,
            "frames": self.frames,
            "graphs": {graph: {name: asdict(e) for name, e in errors.items()} for graph, errors in self.graphs.items()},
            "stream": [asdict(error) for error in self.stream],
            "coverage": asdict(self.coverage),
            "random_inputs": self.random_inputs,
            "elements": {graph: liveness.elements for graph, liveness in self.liveness.items()},
            "wrong_elements": self.wrong_elements,
            "weights": weights and {name: getattr(weights, name) for name in WeightMatchRecord.model_fields},
            "retrace": self.retrace and {"graphs": self.retrace.graphs, "skipped": self.retrace.skipped},
        }
        return ParityReport.model_validate(replace_nonfinite(report))


def tolerance_of(error: TensorError) -> float:
    """The largest accepted error, on a frame or on random inputs."""
    if error.quantized:
        return INT8_TOLERANCES.graph if error.seed is None else INT8_TOLERANCES.dequantized
    return GRAPH_TOLERANCE if error.seed is None else RANDOM_TOLERANCE


def size_of(error: TensorError) -> float:
    """The error that is compared with the tolerance."""
    return error.rms if error.quantized else error.relative


def _describe(error: TensorError) -> str:
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


def _stream_failures(index: int, error: FrameError, precision: Precision) -> list[str]:
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
